/* The word that a student gets: right, wrong or cannot tell, why, and what to do next. Texts are left
   to the page (drop.js): here are their keys, and the values in them. */

const WRONG = "wrong";
const CANNOT_TELL = "cannot tell";
const UNKNOWN = "unknown";
const STRANGE = 0.3; // unexplained pixels per pixel of outline from which a picture shows another scene
const DESPITE = 300; // gain from which a mistake is named even so
const BLIND = 0.1; // a check that would miss a brightness off by so much says nothing
const WELL = 0.4; // a free light explains a picture if it leaves so little of the misfit
const POINTLIKE = 0.15; // its standard deviation, in edges, where it is a point
const BESIDE = 0.1; // its share off the light where it is elsewhere
const ELSEWHERE = "quad_parametrisation_wrong";
const NEAR = 0.02; // brightness that no mistake explains, within which a picture may still be right
const HOPELESS = 1e6; // odds against from which another explanation is not worth a word
const SURE = 0.9; // a picture of which less is sure is not called right
const BLACK = 1.5 / 255;
const COLOURLESS = "flat_colour_missing"; // the mistake that colours show, and no brightness
const SLIGHT = 0.01; // relative error of the mean below which a framework's own habits may be the reason
const UNNAMED = 60; // gain from which a picture is called wrong though no mistake explains it
const FEW_PIXELS = 60;
/* Scenes that show what the lab's does not. */
const SHOWN_BY = {
  "tp3_sheared.json": ["area_by_norms"],
  "tp3_two_quads.json": [
    "divided_inside_light_loop",
    "averaged_over_lights",
    "only_one_light",
    "flat_colour_squared",
  ],
};

function verdictOf(diagnosis, miss) {
  const {
    view,
    best: { variant: top },
  } = diagnosis;
  const { picture } = view;
  const n = picture.lightSamples;
  const strange = isStrange(picture, miss);
  const [brightness, samples] = detectable(view, diagnosis.right.variant);
  const decided = decide(diagnosis, strange, brightness);
  const shown = coloured(view).length ? [COLOURLESS] : [];
  // Of what colours show, the hypotheses, which are of brightness, know nothing.
  const confidence = String(decided.mistakes) === COLOURLESS ? 1 : confidenceOf(diagnosis, decided.verdict);
  const hidden = decided.verdict === "right" ? diagnosis.hidden.filter((name) => !shown.includes(name)) : [];
  const facts = factsOf(diagnosis, miss, strange, decided.verdict);
  if (decided.verdict === "right" && confidence < SURE) decided.verdict = CANNOT_TELL;
  return {
    ...decided,
    confidence,
    facts,
    hidden,
    alike: decided.verdict === WRONG && !decided.mistakes.includes(UNKNOWN) ? diagnosis.alike : [],
    regions: regionsOf(view, baseOf(top, view)),
    effectiveSamples: effectiveSamples(diagnosis),
    detectableBrightness: brightness,
    detectableSamples: samples * n,
    runnersUp: runnersUp(diagnosis),
    settle: settle(decided.verdict, view, strange, brightness, hidden),
    loose: diagnosis.loose,
    scene: view.scene.name,
    lightSamples: n,
    pixelSamples: picture.pixelSamples,
    grid: view.grid,
    law: picture.law,
    variant: top,
    gain: diagnosis.best.score - diagnosis.right.score,
  };
}

/* verdict, sure names, perhaps, several; beside, the share of a free light that is not on the light. */
function decide(diagnosis, strange, brightness) {
  const { view, best, right, sure } = diagnosis;
  const top = best.variant;
  const names = mistakesOf(top);
  const word = (verdict, mistakes = [], perhaps = [], several = false, beside = 0) => ({
    verdict,
    mistakes,
    perhaps,
    several,
    beside,
  });
  const gain = best.score - right.score;
  const named = names.length > 0 && gain > ACCUSED;
  let unexplained = diagnosis.unexplained > ACCUSED;
  if (named) {
    const off = diagnosis.unexplained > ACCUSED / 3 && diagnosis.loose >= SLIGHT;
    unexplained = off || diagnosis.unexplained > 3 * ACCUSED || diagnosis.local > LOCAL;
  }
  const rest = names.filter((name) => !sure.includes(name));
  if (strange && !(named && !unexplained && gain > DESPITE)) return word(CANNOT_TELL);
  if (largest(view.value) < BLACK) return word(WRONG, ["black"]);
  if (unexplained) {
    if ((named || diagnosis.loose >= NEAR) && diagnosis.unexplained > 0) {
      const light = freeLight(view);
      // and not by being only a darker or brighter light
      const dimmed = { ...RIGHT_VARIANT, factor: view.bestFactor(RIGHT_VARIANT) };
      const well = WELL * Math.max(Math.min(misfitOf(view, top), misfitOf(view, dimmed)), 1e-9);
      const name = light && light.misfit < Math.min(3, well) ? nameOfLight(light, view) : "";
      if (name) return word(WRONG, [name], [], false, name === ELSEWHERE ? 1 - light.inside : 0);
    }
    if (view.picture.jpeg === "coarse") return word(CANNOT_TELL);
    if (named && sure.length > 1) return word(WRONG, [...sure, UNKNOWN], rest, true);
    if (named) return word(WRONG, [UNKNOWN], names);
    if (diagnosis.loose >= NEAR && diagnosis.unexplained > UNNAMED) return word(WRONG, [UNKNOWN]);
    return word(CANNOT_TELL);
  }
  if (named) {
    const certain = sure.length ? sure : names;
    return word(WRONG, certain, sure.length ? rest : [], certain.length > 2);
  }
  if (brightness > BLIND) return word(CANNOT_TELL);
  if (whitened(view)) return word(WRONG, [COLOURLESS]);
  const { factor } = right.variant;
  if (factor !== 1 && !plausiblePower(view, factor)) return word(CANNOT_TELL);
  return word("right");
}

/* The name of the mistake that a free light shows, if it does. */
function nameOfLight({ points, weights, inside }, view) {
  const total = Math.max(sum(weights), 1e-9);
  const mean = (of) => sum(weights.map((weight, k) => weight * of(points[k]))) / total;
  const spread = [0, 1].map((axis) => {
    const middle = mean((point) => point[axis]);
    return Math.sqrt(mean((point) => square(point[axis] - middle)));
  });
  if (spread.every((width) => width < POINTLIKE)) return "light_point_fixed";
  if (inside < 1 - BESIDE) return ELSEWHERE;
  const noises = regionsOf(view, RIGHT_VARIANT)
    .map((region) => region.noise)
    .filter((noise) => noise > 0);
  return noises.length && Math.max(...noises) < 0.3 ? "same_samples_everywhere" : "";
}

function misfitOf(view, variant) {
  const { residual, residualVariance } = view.heldAgainst(variant);
  return sum(residual.map((off, c) => Math.min(square(off) / residualVariance[c], 25))) / view.cells;
}

/* The scene's objects that are clearly not grey or white. */
function coloured(view) {
  return view.scene.objects.filter(({ color }) => Math.min(...color) < 0.75 * Math.max(...color));
}

/* Whether all of these are white in the picture. */
function whitened(view) {
  const seen = coloured(view).map((thing) => view.recoloured[thing.name]);
  return seen.length > 0 && seen.every((colour) => colour && Math.min(...colour) > 0.9);
}

/* What the picture is held against: what is right, in another power if that is all; where only the
   noise is wrong, with that noise, since a clamp turns it into brightness. */
function baseOf(top, view) {
  if (!mistakesOf(top).length) return top;
  return constant(top, view.scene.light, view.picture.lightSamples) === 1 ? top : RIGHT_VARIANT;
}

/* Whether somebody would type such a power: a number of one or two digits, but for the fit's own error. */
function plausiblePower(view, factor) {
  const power = factor * Math.max(...view.scene.light.radiance);
  const digits = Math.pow(10, Math.floor(Math.log10(power)) - 1);
  const near = view.picture.jpeg ? 0.012 : 0.006;
  return Math.abs(power / digits - Math.round(power / digits)) * digits < near * power;
}

/* Whether the picture's outline is not the scene's. */
function isStrange({ background: shows, width }, miss) {
  let edge = 0;
  for (let p = 0; p < shows.length; p++) {
    if (p >= width && shows[p] !== shows[p - width]) edge++;
    if (p % width && shows[p] !== shows[p - 1]) edge++;
  }
  return miss > STRANGE * Math.max(edge, 1) + 20;
}

/* The relative error of the mean, and the share of the light samples, whose expected gain is just
   what an accusation takes. */
function detectable(view, variant) {
  const found = view.heldAgainst(variant);
  const wanted = (ACCUSED + PRICE_ONE) / TEMPER;
  const total = (of) => sum(range(view.cells).map((c) => 0.5 * (NU + 1) * Math.log1p(of(c) / NU)));
  const gain = (delta) =>
    total((c) => (found.mean[c] < 0.95 ? square(delta * found.mean[c]) / found.residualVariance[c] : 0));
  const gainOfNoise = (ratio) =>
    total((c) =>
      found.foretoldNoise[c] > 4 * Math.max(view.picture.quantisationVariance, 1e-9)
        ? square(Math.log(ratio)) / found.noiseVariance[c]
        : 0,
    );
  const smallest = (of, low, high) => {
    if (of(high) < wanted) return high;
    for (let i = 0; i < 40; i++) {
      const middle = Math.sqrt(low * high);
      [low, high] = of(middle) > wanted ? [low, middle] : [middle, high];
    }
    return high;
  };
  return [smallest(gain, 1e-5, 1), 1 / smallest(gainOfNoise, 1.0001, 1e4)];
}

/* Each object's lit part, penumbra and shadow against what is right: kind, object, ratio (of a shadow
   observed [0, 1]), its standard error, noise (observed over foretold variance within cells; 0: not
   known), trend of the ratio against the log distance from the light. */
function regionsOf(view, right) {
  const law = view.predict(right);
  const { around, value, scene, picture } = view;
  const { chance, first } = around.moments.get(STD);
  const { point } = around.moments.sites;
  const found = [];
  const kindOf = (i) =>
    chance[i] < 0.001 || first[i] <= 0 ? "shadow" : chance[i] > 0.999 ? "lit" : "penumbra";
  scene.objects.forEach((thing, object) => {
    for (const kind of ["lit", "penumbra", "shadow"]) {
      const use = range(value.length).filter(
        (i) =>
          view.objectId[i] === object &&
          kindOf(i) === kind &&
          (kind === "shadow" || (law.mean[i] > 0.02 && law.mean[i] < 0.93)),
      );
      if (use.length < FEW_PIXELS) continue;
      const total = (of) => use.reduce((all, i) => all + of(i), 0);
      const seen = total((i) => value[i]);
      const region = {
        kind,
        object: thing.name,
        ratio: seen / use.length,
        standardError: 0,
        noise: 0,
        trend: 0,
      };
      found.push(region);
      if (kind === "shadow") continue;
      const mean = total((i) => law.mean[i]);
      const varianceOf = (i) => law.variance[i] + picture.quantisationVariance;
      region.ratio = seen / mean;
      region.standardError = Math.sqrt(total(varianceOf)) / mean;
      const far = new Map(use.map((i) => [i, Math.log(distanceTo(point, i, scene.light.corner))]));
      if (largest([...far.values()]) + largest([...far.values()].map((x) => -x)) > 0.2 && region.ratio > 0) {
        // a line through the ratios, weighed by the mean
        const x0 = total((i) => law.mean[i] * far.get(i)) / mean;
        const each = (i) => clip(value[i] / law.mean[i], 0, 10);
        const slope =
          total((i) => law.mean[i] * (far.get(i) - x0) * each(i)) /
          total((i) => law.mean[i] * square(far.get(i) - x0));
        region.trend = slope / region.ratio;
      }
      region.noise = noiseOf(view, use, (i) => value[i] - law.mean[i], varianceOf);
    }
  });
  return found;
}

/* Observed over foretold variance within cells; 0 where there is none to speak of. */
function noiseOf(view, use, residual, variance) {
  const cells = new Map();
  let all = 0;
  for (const i of use) {
    const cell = cells.get(view.cell[i]) || { count: 0, one: 0, two: 0, foretold: 0 };
    cell.count++;
    cell.one += residual(i);
    cell.two += square(residual(i));
    cell.foretold += variance(i);
    all += variance(i);
    cells.set(view.cell[i], cell);
  }
  const full = [...cells.values()].filter((cell) => cell.count >= 6);
  if (!full.length || all / use.length < 4 * view.picture.quantisationVariance) return 0;
  const within = ({ count, one, two }) => ((two / count - square(one / count)) * count) / (count - 1);
  return sum(full.map(within)) / sum(full.map((cell) => cell.foretold / cell.count));
}

/* The number of light samples that the noise is that of, by the penumbrae. */
function effectiveSamples({ view, best: { variant: top } }) {
  const n = view.picture.lightSamples;
  const factor = mistakesOf(top).length ? 1 : top.factor;
  const found = regionsOf(view, { ...RIGHT_VARIANT, factor })
    .filter((r) => r.kind === "penumbra" && r.noise > 0 && r.ratio > 0)
    .map((r) => (n * square(r.ratio)) / r.noise);
  return found.length ? median(found) : n;
}

/* Of the hypotheses that were compared, the share of those that say the same word. */
function confidenceOf({ best, ranking, unexplained }, word) {
  if (word === CANNOT_TELL) return 0.5;
  const loose = Math.exp(Math.min(unexplained, 700));
  let same = word === WRONG ? loose : 0;
  let other = word === WRONG ? 0 : loose;
  for (const { variant, score } of ranking) {
    const weight = Math.exp(score - best.score);
    if (mistakesOf(variant).length > 0 === (word === WRONG)) same += weight;
    else other += weight;
  }
  return same / (same + other);
}

function runnersUp({ best, ranking }) {
  const own = mistakesOf(best.variant);
  const others = ranking.map(({ variant, score }) => ({
    names: mistakesOf(variant),
    odds: Math.exp(Math.min(best.score - score, 700)),
  }));
  return others
    .filter(
      ({ names }) =>
        String(names) !== String(own) && (!own.length || !own.every((name) => names.includes(name))),
    )
    .slice(0, 3)
    .filter(({ odds }) => odds < HOPELESS);
}

/* Of the picture, no faults of the light: code, the page's text for it, values. */
function factsOf(diagnosis, miss, strange, word) {
  const { view } = diagnosis;
  const { picture, scene } = view;
  const facts = [...gridFacts(view.grid, scene), ...picture.facts];
  if (strange) facts.push({ code: "geometry", text: "geometry", values: { miss } });
  for (const thing of scene.objects.filter(({ name }) => name in view.recoloured)) {
    const shares = (rgb) => ({ list: rgb.map((c) => c / Math.max(...rgb, 1e-9)), format: ".2g" });
    facts.push({
      code: `colours ${thing.name}`,
      text: "colours",
      values: {
        object: thing.name,
        colour: shares(view.recoloured[thing.name]),
        stated: shares(thing.color),
      },
    });
  }
  if (picture.jpeg) facts.push({ code: "jpeg", text: "jpeg", values: {} });
  const { factor } = (word === "right" ? diagnosis.right : diagnosis.best).variant;
  if (factor !== 1 && word !== CANNOT_TELL) {
    const stated = Math.max(...scene.light.radiance);
    const close = Number((stated * factor).toPrecision(2));
    const power = Math.abs((stated * factor) / close - 1) < 0.006 ? close : stated * factor;
    facts.push({ code: "power", text: "power", values: { power, stated } });
  }
  const times = word === "right" ? effectiveSamples(diagnosis) / picture.lightSamples : 0;
  if (times > 1.5) facts.push({ code: "better_sampler", text: "better_sampler", values: { times } });
  const share = view.value.filter((v) => v >= 1).length / view.value.length;
  if (share > 0.05) facts.push({ code: "saturated", text: "saturated", values: { share } });
  return facts;
}

/* What would settle it, or show more: keys of WORDS and values. */
function settle(word, view, strange, brightness, hidden) {
  const said = [];
  const add = (key, values = {}) => said.push({ text: key, values });
  if (strange) add("settle_camera", { scene: `scenes/${view.scene.name}.json` });
  if (word === CANNOT_TELL && view.picture.jpeg) add("settle_png");
  if (word === CANNOT_TELL && brightness > BLIND) add("settle_size");
  if (view.picture.lightSamples < 16) add("settle_n");
  for (const [scene, shows] of Object.entries(SHOWN_BY))
    if (shows.some((name) => hidden.includes(name))) add("settle_scene", { scene });
  return said;
}
