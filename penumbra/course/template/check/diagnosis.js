/* Which renderer made this picture: the right one, one of the catalogue's, or neither. Every
   hypothesis (a variant, two mistakes at once, or an unexplained brightness) foretells mean and noise
   of every cell; they are compared by likelihood, with a price on each mistake that is what keeps
   correct renderers from being accused (docs/check.md). First coarsely, on part of the cells, then
   the best ones on all. */

const TEMPER = 0.5; // cells are not quite independent of each other: what a log-likelihood counts
/* Of one mistake, two, each further one, an unexplained brightness beside a mistake, and more for what
   may explain nearly any mean, in units of the tempered log-likelihood. */
const PRICE_ONE = 25;
const PRICE_TWO = 60;
const PRICE_MORE = 25;
const PRICE_FACTOR = 45;
const PRICE_DIFFUSE = 60;
const ACCUSED = 15; // gain over `right` from which a picture is called wrong
/* How far, relative, the mean may be off where no hypothesis holds. */
const LOOSE = [0.005, 0.01, 0.02, 0.05, 0.1, 0.3];
const POWERS = [0.5, 2];
const POWER_OR = ["area_halved", "light_twice"]; // mistakes that are no more than another power
const KNOWN = 0.008; // a brightness as near as this, relative, to a known mistake's is that mistake
const KNOWN_AT_ONE = 0.03; // where one light sample is taken, whose noise hides as much
const PARTS = 6;
const COARSE_GRID = 8;
const FINE_GRID = 12;
const FEW_CELLS = 0.03; // of the cells may be anything, where it is asked whether a hypothesis holds in all
const LOCAL = 30; // gain of that from which it does not
const FINALISTS = 12;
const FAR_BEHIND = 80;
const SEEDS = 8;
const MOST_MISTAKES = 4;
/* What is tried together with samples that fall beside the light. */
const WEIGHTS_WITH_DOMAIN = [
  "std",
  "pdf_times_cos",
  "no_light_cosine",
  "no_receiver_cosine",
  "cos_of_cos_receiver",
  "distance_not_squared",
  "distance_omitted",
];

/* progress(share): told how far the search is. */
async function diagnose(view, progress) {
  const search = new Search(view, progress);
  await search.coarse();
  return search.fine();
}

class Search {
  constructor(view, progress) {
    Object.assign(this, { view, progress, scored: new Map(), variants: new Map(), held: new Map() });
    this.many = view.picture.pixelSamples > 1;
    this.known = this.singles()
      .filter((v) => wrongOf(v).length && !this.isPower(v))
      .map((v) => constant(v, view.scene.light, view.picture.lightSamples))
      .filter((k) => k !== null && k > 0);
  }

  // -- scores

  score(view, variant, loose = 0) {
    const key = `${nameOf(variant)} ${view.quick} ${loose}`;
    if (!this.held.has(key))
      this.held.set(key, sum(view.loglik(this.found(view, variant), mayBeQuiet(variant), loose)));
    return TEMPER * this.held.get(key) - this.price(variant);
  }

  found(view, variant) {
    const key = `${nameOf(variant)} ${view.quick}`;
    if (!this.held.has(key)) this.held.set(key, view.heldAgainst(variant));
    return this.held.get(key);
  }

  price(variant) {
    const number = mistakesOf(variant).length;
    let price = 0;
    if (number === 1) {
      price = PRICE_ONE;
      if (variant.generator !== RIGHT || choiceOf(variant, "weight").mistake === "receiver_cosine_unclamped")
        price += PRICE_DIFFUSE;
    } else if (number) {
      price = PRICE_TWO + PRICE_MORE * (number - 2);
    }
    const cheap = !number || POWERS.some((power) => Math.abs(variant.factor / power - 1) < KNOWN);
    return price + (variant.factor === 1 ? 0 : cheap ? PRICE_ONE : PRICE_FACTOR);
  }

  async tryAll(variants) {
    const news = new Map(variants.map((v) => [nameOf(v), v]));
    for (const [name, variant] of news) if (this.scored.has(name) || this.isPower(variant)) news.delete(name);
    await this.part.around.moments.prepare(keysOf([...news.values()]));
    for (const [name, variant] of news) {
      const price = this.price(variant);
      this.variants.set(name, variant);
      // what all cells would say
      this.scored.set(name, PARTS * (this.score(this.part, variant) + price) - price);
    }
  }

  /* Whether it is no more than half or twice the power. */
  isPower(variant) {
    if (POWER_OR.includes(variant.scale)) return true;
    if (wrongOf(variant).length !== 1) return false;
    const k = constant(variant, this.view.scene.light, this.view.picture.lightSamples);
    return k !== null && POWERS.some((power) => Math.abs(k / power - 1) < KNOWN);
  }

  /* With the brightness that fits best, unless a known mistake has that one. */
  withFactor(variant) {
    const {
      part,
      part: { picture },
    } = this;
    const factor = part.bestFactor(variant);
    const near = Math.max(
      KNOWN,
      KNOWN_AT_ONE / Math.sqrt(picture.lightSamples * picture.pixelSamples),
      0.5 / 255 / Math.max(quantile(part.mean(part.value), 0.9), 1 / 255),
    ); // a dim picture has few levels
    return this.known.some((known) => Math.abs(factor / known - 1) < near) ? variant : { ...variant, factor };
  }

  // -- search

  async coarse() {
    const { view } = this;
    const ones = this.singles();
    this.part = await view.part(PARTS, COARSE_GRID);
    await this.tryAll([RIGHT_VARIANT, ...ones]);
    this.progress(0.45);
    await this.tryAll([this.withFactor(RIGHT_VARIANT)]);
    let [best] = this.ordered();
    if (this.looseness(this.part, best)[1] > 0) {
      const shapes = ones.filter((v) => keyOf(v) !== STD);
      shapes.push(...["n_no_effect", "running_half"].map((average) => ({ ...RIGHT_VARIANT, average })));
      await this.tryAll(shapes.map((v) => this.withFactor(v)));
      const seeds = new Map(
        this.ordered()
          .filter((v) => mistakesOf(v).length)
          .map((v) => ({ ...v, factor: 1 }))
          .map((v) => [nameOf(v), v]),
      );
      for (const [i, seed] of [...seeds.values()].slice(0, SEEDS).entries()) {
        await this.tryAll(this.pairs(seed));
        this.progress(0.5 + (0.3 * (i + 1)) / SEEDS);
      }
    } else if (mistakesOf(best).length) {
      await this.tryAll(this.pairs({ ...best, factor: 1 }));
    }
    [best] = this.ordered();
    while (mistakesOf(best).length > 1 && this.looseness(this.part, best)[1] > ACCUSED / PARTS) {
      await this.tryAll(this.pairs(best));
      const [better] = this.ordered();
      if (better === best || mistakesOf(better).length > MOST_MISTAKES) break;
      best = better;
    }
    this.progress(0.85);
  }

  ordered() {
    return [...this.scored].sort((a, b) => b[1] - a[1]).map(([name]) => this.variants.get(name));
  }

  /* The relative error of its mean that fits best, and what saying so gains in score. */
  looseness(view, variant) {
    const own = this.score(view, variant);
    const [gain, loose] = LOOSE.map((loose) => [this.score(view, variant, loose) - own, loose]).reduce(
      (a, b) => (b[0] > a[0] || (b[0] === a[0] && b[1] > a[1]) ? b : a),
    );
    return gain > 0 ? [loose, gain] : [0, gain];
  }

  /* What it gains in score if a few cells may be anything. */
  local(variant) {
    const { view } = this;
    const found = this.found(view, variant);
    const quiet = mayBeQuiet(variant);
    const own = view.loglik(found, quiet);
    const free = view.loglik(
      {
        ...found,
        residualVariance: found.residualVariance.map((v) => v + 0.01),
        noiseVariance: found.noiseVariance.map((v) => v + 4),
      },
      quiet,
    );
    return (
      TEMPER *
      sum(
        own.map((mine, c) => {
          const a = mine + Math.log(1 - FEW_CELLS);
          const b = free[c] + Math.log(FEW_CELLS);
          return Math.max(a, b) + Math.log1p(Math.exp(-Math.abs(a - b))) - mine;
        }),
      )
    );
  }

  async fine() {
    const { view } = this;
    const ordered = this.ordered();
    const best = this.scored.get(nameOf(ordered[0]));
    const finalists = ordered
      .slice(0, FINALISTS)
      .filter((v) => this.scored.get(nameOf(v)) > best - FAR_BEHIND);
    for (const v of [RIGHT_VARIANT, ...ordered.filter((v) => !mistakesOf(v).length).slice(0, 2)]) {
      if (!finalists.some((other) => nameOf(other) === nameOf(v))) finalists.push(v);
    }
    await view.around.moments.prepare(keysOf(finalists));
    const found = new Map(finalists.map((v) => [nameOf(v), { variant: v, score: this.score(view, v) }]));
    const top = [...found.values()].reduce((a, b) => (b.score > a.score ? b : a));
    const losses = new Map();
    for (const choice of wrongOf(top.variant)) {
      const less = { ...top.variant, [choice.module]: RIGHT };
      if (!found.has(nameOf(less))) {
        await view.around.moments.prepare(keysOf([less]));
        found.set(nameOf(less), { variant: less, score: this.score(view, less) });
      }
      losses.set(choice.mistake, top.score - found.get(nameOf(less)).score);
    }
    const sure = [...losses]
      .sort((a, b) => b[1] - a[1])
      .filter(([, loss]) => loss > ACCUSED)
      .map(([name]) => name);
    const hypotheses = [...found.values()].sort((a, b) => b.score - a.score);
    const ranking = new Map();
    for (const hypothesis of hypotheses) {
      const names = mistakesOf(hypothesis.variant);
      const key = `${names} ${names.length > 0 && hypothesis.variant.factor !== 1}`;
      if (!ranking.has(key)) ranking.set(key, hypothesis);
    }
    this.progress(0.95);
    const [loose, unexplained] = this.looseness(view, top.variant);
    return {
      view,
      ranking: [...ranking.values()],
      loose,
      unexplained,
      sure,
      right: hypotheses.find((h) => !mistakesOf(h.variant).length),
      best: hypotheses[0],
      alike: this.alike(top.variant),
      hidden: await this.hidden(top.variant),
      local: this.local(top.variant),
    };
  }

  /* Names of those that foretell what the best one foretells. */
  alike(top) {
    const own = this.scored.get(nameOf(top));
    const names = mistakesOf(top);
    const same = new Map();
    if (own === undefined) return [];
    for (const [name, score] of this.scored) {
      const variant = this.variants.get(name);
      const others = mistakesOf(variant);
      if (
        others.length &&
        others.length === names.length &&
        variant.factor === top.factor &&
        String(others) !== String(names) &&
        Math.abs(score - own) < PARTS &&
        this.apart(variant, top) < 1
      )
        same.set(String(others), others);
    }
    return [...same.values()];
  }

  /* Names, none of whose choices would show as an addition to what is right. */
  async hidden(top) {
    if (mistakesOf(top).length) return [];
    const shown = new Map();
    const variants = this.singles(true);
    await this.part.around.moments.prepare(keysOf([...variants, top]));
    for (const variant of variants) {
      for (const choice of wrongOf(variant)) {
        const seen = usable(choice, this.many) && this.apart(variant, top) > ACCUSED + PRICE_ONE;
        shown.set(choice.mistake, shown.get(choice.mistake) || seen);
      }
    }
    return [...shown].filter(([, seen]) => !seen).map(([name]) => name);
  }

  /* How far, on average, the one's score is above the other's where it is the truth. */
  apart(a, b) {
    return TEMPER * this.part.apart(this.found(this.part, a), this.found(this.part, b)) * PARTS;
  }

  // -- hypotheses

  /* One choice of the catalogue each, sound ones included. many: pictures might have several pixel
     samples. */
  singles(many = this.many) {
    return CATALOGUE.filter((choice) => choice.name !== RIGHT && usable(choice, many)).flatMap((choice) =>
      widened(replaced(RIGHT_VARIANT, choice)),
    );
  }

  /* With one mistake more, of another module. */
  pairs(variant) {
    return CATALOGUE.filter(
      (choice) =>
        choice.mistake &&
        [RIGHT, "offset_0", "offset_0_01"].includes(variant[choice.module]) &&
        usable(choice, this.many) &&
        sensible(replaced(variant, choice)),
    ).flatMap((choice) => widened(replaced(variant, choice)));
  }
}

/* The moments that they need. */
function keysOf(variants) {
  const keys = new Set();
  for (const variant of variants) {
    keys.add(keyOf(variant));
    if (field(choiceOf(variant, "visibility"), "target") || shadedApart(choiceOf(variant, "average")))
      keys.add(unhidden(variant));
  }
  return [...keys];
}

/* Without several pixel samples an early clamp is the output's clamp. */
function usable(choice, many) {
  return choice.kind !== "PIXEL" || many;
}

/* Where the chance of a visible sample matters by itself, so does the small offset. */
function widened(variant) {
  if (
    choiceOf(variant, "average").macro !== SPLIT ||
    variant.visibility !== RIGHT ||
    variant.domain !== RIGHT
  )
    return [variant];
  return [RIGHT, "offset_0", "offset_0_01"].map((visibility) => ({ ...variant, visibility }));
}

/* Whether noise that is lower than foretold by one factor is only a better sampler's: unless what it
   gets wrong is the noise itself. */
function mayBeQuiet(variant) {
  const ray = choiceOf(variant, "visibility");
  const loud = field(ray, "lost") || field(ray, "apart") || field(choiceOf(variant, "output"), "acne");
  return variant.average === RIGHT && variant.generator === RIGHT && !loud;
}

/* The factor by which a mistake changes all brightness, if that is all it does to the mean; else null. */
function constant(variant, light, n) {
  const [wrong, ...more] = wrongOf(variant);
  const average = choiceOf(variant, "average");
  if (!wrong || more.length || !["scale", "average"].includes(wrong.module) || average.macro === SPLIT)
    return null;
  return brightness(light, variant, n) * weightsOf(average, n).one;
}

/* Not a pair that equals one of its mistakes. */
function sensible(variant) {
  const ray = choiceOf(variant, "visibility");
  const splits = choiceOf(variant, "average").macro === SPLIT;
  const alone = wrongOf(variant).length === 1;
  if (splits && (field(ray, "target") || field(ray, "ignored") || field(ray, "apart"))) return false;
  if (variant.domain !== RIGHT) {
    if (![RIGHT, "none"].includes(variant.visibility) || !WEIGHTS_WITH_DOMAIN.includes(variant.weight))
      return false;
    if (
      onePlace(variant) &&
      (splits ||
        ["n_no_effect", "running_half"].includes(variant.average) ||
        variant.clamp === "per_light_sample" ||
        variant.generator !== RIGHT)
    )
      return false;
  }
  // with another mistake nearly every picture would be possible
  if (variant.generator !== RIGHT || variant.scale === "normal_reversed") return alone;
  return true;
}
