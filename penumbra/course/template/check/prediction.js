/* From one sample's moments to a pixel: its mean and its noise for any N, M, clamp and output.
   CATALOGUE, made from catalogue.def, has its expressions as functions.

   A pixel sample is a product of what is visible and what is shaded. With p the chance that a sample
   sees the light, and w its value where it does, of mean m and variance s2, every average has
   mean = A(p) m, mean square = B(p) m^2 + C(p) s2. docs/check.md derives it. */

const MODULES = [
  "domain",
  "visibility",
  "weight",
  "scale",
  "average",
  "clamp",
  "output",
  "colour",
  "generator",
];
const RIGHT = "std";
const SPLIT = "SPLIT";
const MIXTURE = 16; // up to so many samples a clamp acts on each number of visible ones apart
const MOST_PARTS = 81; // of a mixture over the visible samples of several pixel samples
const P_GRID = range(257).map((i) => i / 256);
const WRAP = 256 / 255; // what wraps to 0

const CHOICES = new Map(CATALOGUE.map((choice) => [`${choice.module} ${choice.name}`, choice]));
const RIGHT_VARIANT = { ...Object.fromEntries(MODULES.map((module) => [module, RIGHT])), factor: 1 };

/* A variant is a renderer: the name of a choice in each module, and an unexplained constant factor. */
const choiceOf = (variant, module) => CHOICES.get(`${module} ${variant[module]}`);
const wrongOf = (variant) =>
  MODULES.map((module) => choiceOf(variant, module)).filter((choice) => choice.mistake);
const mistakesOf = (variant) => [...new Set(wrongOf(variant).map((choice) => choice.mistake))].sort();
const replaced = (variant, choice) => ({ ...variant, [choice.module]: choice.name });
const nameOf = (variant) => MODULES.map((module) => variant[module]).join(" ") + ` ${variant.factor}`;
const keyOf = (variant) => `${variant.domain} ${variant.visibility} ${variant.weight}`;
const unhidden = (variant) => `${variant.domain} none ${variant.weight}`;
const field = (choice, name) => choice.fields[name] || 0;
/* Whether what is shaded are not the visible samples. */
const shadedApart = (average) =>
  average.macro === SPLIT && (average.kind === "APART" || average.kind === "FIRST");

/* Mean and variance of every pixel: linear, before they become 8 bits. n: light samples; m: pixel
   samples; jittered: these are at random places; quick: clamps act on normal distributions only. */
function predict(around, variant, n, m, jittered, quick) {
  const [ray, average, output] = ["visibility", "average", "output"].map((module) =>
    choiceOf(variant, module),
  );
  const clamp = choiceOf(variant, "clamp").kind;
  const [colourOf] = choiceOf(variant, "colour").functions;
  const fixed = field(ray, "target") > 0 || onePlace(variant);
  const factor = brightness(around.light, variant, n);
  const { chance, first, second } = around.moments.get(keyOf(variant));
  // where w is not that of the visible samples
  const other = field(ray, "target") || shadedApart(average) ? around.moments.get(unhidden(variant)) : null;
  const whole = other || (field(ray, "apart") ? { first, second } : null);
  const kept = 1 - field(ray, "lost");
  const fog = field(output, "fog");
  const ambient = field(output, "ambient");
  const acne = field(output, "acne");
  const unclamped = variant.weight.includes("unclamped");
  const pixel = clamp === "PIXEL";
  const within = pixel ? 1 : m;
  const end = field(output, "wrap") && !pixel ? wrapped : clipped;
  const abc = averageOf(average, n, fixed);
  const mixture = quick || fixed ? null : mixtureOf(average, n, within);
  const most = mixture && mostOf(average, n);
  const size = chance.length;
  const mean = new Float64Array(size);
  const variance = new Float64Array(size);
  for (let i = 0; i < size; i++) {
    const seen = whole ? 1 : chance[i] > 0 ? chance[i] : 1;
    const p = chance[i] * kept;
    const colour = colourOf(around.flatColour[i]);
    const gain = colour * around.radiance[i];
    let shaded = (whole ? whole.first : first)[i] / seen;
    let s2 = Math.max((whole ? whole.second : second)[i] / seen - shaded * shaded, 0) * gain * gain;
    shaded *= gain;
    if (clamp === "LIGHT") [shaded, s2] = clipped(shaded, s2);
    shaded *= factor;
    s2 *= factor * factor;
    const [a, b, c] = abc(p);
    const between = a * shaded;
    let mu = between;
    let spread = Math.max(b * shaded * shaded + c * s2 - mu * mu, 0);
    // the moments' own error: jittered points
    if (!fixed)
      spread += square((0.35 / Math.pow(around.moments.grid, 1.5)) * shaded) * Math.min(1, 16 * p * (1 - p));
    if (unclamped) {
      spread = mu > 0 ? spread : 0;
      mu = Math.max(mu, 0);
    }
    const left = fog ? Math.exp(-fog * around.distance[i]) : 1;
    const across = jittered ? left * left * around.slope[i] * between * between : 0;
    const extra = left * ambient * colour + (1 - left) * around.background[i];
    mu = left * mu + extra;
    spread *= left * left;
    let parts = null;
    if (mixture && p > 0 && p < 1 && (extra + left * most * shaded > 0.9 || mu + 4 * Math.sqrt(spread) > 1)) {
      parts = mixture(p, left * shaded, left * left * s2);
    }
    if (parts) {
      const slope = jittered ? around.slope[i] / within : 0;
      let one = 0;
      let two = 0;
      for (const [weight, x, s] of parts) {
        const [first_, second_] = end(extra + x, s + slope * x * x);
        one += weight * first_;
        two += weight * (second_ + first_ * first_);
      }
      mu = one;
      spread = Math.max(two - one * one, 0);
    } else {
      spread = (spread + across) / within;
      if (mu + 4 * Math.sqrt(spread) > 1) [mu, spread] = end(mu, spread);
    }
    if (pixel) spread /= m;
    if (acne) {
      // a part of the pixels black, the same for all samples
      spread = (1 - acne) * (spread + mu * mu) - square((1 - acne) * mu);
      mu *= 1 - acne;
    }
    mean[i] = mu;
    variance[i] = spread;
  }
  return { mean, variance, correlation: choiceOf(variant, "generator").kind, rare: acne };
}

/* The constant on every sample of the light. */
function brightness(light, variant, n) {
  return choiceOf(variant, "scale").functions[0](n, light.area, light.norms) * variant.factor;
}

/* Whether all samples of the light are one point of it. */
function onePlace(variant) {
  const places = choiceOf(variant, "domain").functions;
  return places.every((place) => place(0.1, 0.2) === place(0.7, 0.5));
}

/* ---------------------------------------------------------------- averages */

/* Of each sample that is drawn: sums of the weights and of their squares. */
function weightsOf(average, n) {
  const [drawn, weight] = average.functions;
  const weights = range(Math.trunc(drawn(n))).map((i) => weight(n, i));
  return { one: sum(weights), two: sum(weights.map(square)) };
}

/* How often the mean of a visible sample is counted where all of them are visible. */
function mostOf(average, n) {
  return average.macro === SPLIT ? Math.max(...split(average, n).value) : weightsOf(average, n).one;
}

/* A function of p: A, B and C of the module's text. fixed: all samples are seen or none. */
function averageOf(average, n, fixed) {
  if (average.macro === SPLIT) {
    const table = splitTable(average, n);
    const ends = [table[0], table[256]];
    const between = (low, high, share) => low.map((x, k) => x + share * (high[k] - x));
    if (fixed) return (p) => between(...ends, p);
    return (p) => {
      const at = Math.min(Math.floor(256 * p), 255);
      return between(table[at], table[at + 1], 256 * p - at);
    };
  }
  const { one, two } = weightsOf(average, n);
  if (fixed) return (p) => [p * one, square(p * one) + 0.5 * p * (1 - p) * one * one, p * two];
  return (p) => [p * one, square(p * one) + p * (1 - p) * two, p * two];
}

/* Of k = 0 to n visible samples of n: the chance of each where a sample is visible with p, the value,
   and how many are shaded. */
function split({ kind, functions: [value, shaded] }, n) {
  const k = range(n + 1);
  const chance =
    {
      RUN: (p) => k.map((i) => (i < n ? Math.pow(p, i) * (1 - p) : Math.pow(p, n))),
      FIRST: (p) => k.map((i) => (i === 1 ? p : i === 0 ? 1 - p : 0)),
    }[kind] || ((p) => k.map((i) => binomial(n, i, p)));
  return { chance, value: k.map((i) => value(n, i)), shaded: k.map((i) => shaded(n, i)) };
}

const SPLITS = new Map();

/* At each of P_GRID: A, B and C of a value of k visible samples of n. */
function splitTable(average, n) {
  const key = `${average.name} ${n}`;
  if (!SPLITS.has(key)) {
    const { chance, value, shaded } = split(average, n);
    SPLITS.set(
      key,
      P_GRID.map((p) => {
        const found = [0, 0, 0];
        chance(p).forEach((weight, k) => {
          found[0] += weight * value[k];
          found[1] += weight * square(value[k]);
          found[2] += shaded[k] > 0 ? (weight * square(value[k])) / Math.max(shaded[k], 1) : 0;
        });
        return found;
      }),
    );
  }
  return SPLITS.get(key);
}

const LOG_FACTORIALS = [0];
function logFactorial(n) {
  for (let i = LOG_FACTORIALS.length; i <= n; i++) LOG_FACTORIALS.push(LOG_FACTORIALS[i - 1] + Math.log(i));
  return LOG_FACTORIALS[n];
}

/* The chance of k of n. */
function binomial(n, k, p) {
  const log = logFactorial(n) - logFactorial(k) - logFactorial(n - k);
  return Math.exp(log + (k ? k * Math.log(p) : 0) + (n - k ? (n - k) * Math.log1p(-p) : 0));
}

/* ---------------------------------------------------------------- clamps */

/* A function of p, w and s2 (mean and variance of a visible sample): the average of m pixel samples,
   apart for each number of visible light samples, as [chance, mean, variance] of normal
   distributions; null where these are too many to tell. */
function mixtureOf(average, n, m) {
  if (average.macro !== SPLIT) {
    const { one, two } = weightsOf(average, n);
    const samples = two > 0 ? Math.round((one * one) / two) * m : 0; // of equal weight, as good as these
    if (samples > MIXTURE) return null;
    const of = Math.max(samples, 1);
    return (p, w, s2) =>
      range(samples + 1).map((k) => [
        binomial(samples, k, p),
        (one * w * k) / of,
        (one * one * s2 * k) / (of * of),
      ]);
  }
  const { chance, value, shaded } = split(average, n);
  const some = average.kind === "FIRST" ? 2 : n + 1;
  if (n > MIXTURE || Math.pow(some, m) > MOST_PARTS) return null;
  return (p, w, s2) => {
    const one = chance(p)
      .slice(0, some)
      .map((c, k) => [c, (value[k] * w) / m, (square(value[k] / m) * s2) / Math.max(shaded[k], 1)]);
    let found = one;
    for (let i = 1; i < m; i++)
      found = found.flatMap(([c, x, s]) => one.map(([d, y, t]) => [c * d, x + y, s + t]));
    return found;
  };
}

/* Mean and variance of X clamped to [0, 1], X normal. */
function clipped(mean, variance) {
  const sd = Math.sqrt(Math.max(variance, 1e-14));
  const one = atMost(1, mean, sd);
  const zero = atMost(0, mean, sd);
  const first = one[0] - zero[0];
  return [first, Math.max(one[1] - zero[1] - first * first, 0)];
}

/* Means of min(X, top) and of its square, X normal. */
function atMost(top, mean, sd) {
  const a = (top - mean) / sd;
  const density = normalDensity(a);
  const below = normalBelow(a);
  return [
    mean * below - sd * density + top * (1 - below),
    (mean * mean + sd * sd) * below - sd * (mean + top) * density + top * top * (1 - below),
  ];
}

/* Mean and variance of X mod WRAP, X normal. */
function wrapped(mean, variance) {
  const sd = Math.sqrt(Math.max(variance, 1e-12));
  let first = mean;
  let second = mean * mean + variance;
  for (let j = 1; j < 9; j++) {
    const a = (j * WRAP - mean) / sd;
    const tail = normalBelow(-a);
    const part = mean * tail + sd * normalDensity(a);
    first -= WRAP * tail;
    second -= 2 * WRAP * part - (2 * j - 1) * WRAP * WRAP * tail;
  }
  return [first, Math.max(second - first * first, 0)];
}

function normalDensity(a) {
  return Math.exp(-0.5 * Math.min(a * a, 1400)) / Math.sqrt(2 * Math.PI);
}

/* The chance that a standard normal number is below a, to about 1e-15 (West 2005, after Hart 1968). */
function normalBelow(a) {
  const x = Math.abs(a);
  if (x > 37) return a > 0 ? 1 : 0;
  const e = Math.exp((-x * x) / 2);
  let tail;
  if (x < 7.07106781186547) {
    const over =
      (((((0.0352624965998911 * x + 0.700383064443688) * x + 6.37396220353165) * x + 33.912866078383) * x +
        112.079291497871) *
        x +
        221.213596169931) *
        x +
      220.206867912376;
    const under =
      ((((((0.0883883476483184 * x + 1.75566716318264) * x + 16.064177579207) * x + 86.7807322029461) * x +
        296.564248779674) *
        x +
        637.333633378831) *
        x +
        793.826512519948) *
        x +
      440.413735824752;
    tail = (e * over) / under;
  } else {
    tail = e / (x + 1 / (x + 2 / (x + 3 / (x + 4 / (x + 0.65))))) / 2.506628274631;
  }
  return a > 0 ? 1 - tail : tail;
}
