/* What numpy gives the Python: sums, medians, windows over a picture, and its random permutation. */

const square = (x) => x * x;
const clip = (x, low, high) => Math.min(Math.max(x, low), high);
const radians = (degrees) => (degrees * Math.PI) / 180;
const degrees = (radians) => (radians * 180) / Math.PI;
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const range = (count) => Array.from({ length: count }, (_, i) => i);
/* Of numbers, of any length. */
const sum = (values) => values.reduce((total, value) => total + value, 0);
const largest = (values) => values.reduce((top, value) => Math.max(top, value), -Infinity);

/* The entry that `key` makes smallest, the first of equals. */
function least(entries, key) {
  let best = entries[0];
  let lowest = key(best);
  for (const entry of entries.slice(1)) {
    const value = key(entry);
    if (value < lowest) [best, lowest] = [entry, value];
  }
  return best;
}

/* Sorted by a key that is asked for once an entry. */
function sorted(entries, key) {
  return entries
    .map((entry) => [key(entry), entry])
    .sort((a, b) => a[0] - b[0])
    .map((pair) => pair[1]);
}

function quantile(values, share) {
  const ordered = Float64Array.from(values).sort();
  const at = share * (ordered.length - 1);
  const below = Math.floor(at);
  const above = Math.min(below + 1, ordered.length - 1);
  return ordered[below] + (at - below) * (ordered[above] - ordered[below]);
}

const median = (values) => quantile(values, 0.5);

function geometric(low, high, count) {
  return range(count).map((i) => low * Math.pow(high / low, i / (count - 1)));
}

/* The numbers 0 to count - 1, shuffled as numpy.random.default_rng(1).permutation(count) does, so
   that the page looks at the very cells that `penumbra check` looks at (PCG64). */
function permutation(count) {
  const WHOLE = (1n << 128n) - 1n;
  const HALF = (1n << 64n) - 1n;
  const increment = 194290289479364712180083596243593368443n;
  let state = 207833532711051698738587646355624148094n;
  let kept = null;
  const next = () => {
    // 32 bits
    if (kept !== null) {
      const high = kept;
      kept = null;
      return high;
    }
    state = (state * 47026247687942121848144207491837523525n + increment) & WHOLE;
    const folded = (state >> 64n) ^ (state & HALF);
    const turn = state >> 122n;
    const bits = ((folded >> turn) | (folded << (64n - turn))) & HALF;
    kept = Number(bits >> 32n);
    return Number(bits & 0xffffffffn);
  };
  const order = range(count);
  for (let i = count - 1; i > 0; i--) {
    const mask = 2 ** (32 - Math.clz32(i)) - 1;
    let j = (next() & mask) >>> 0;
    while (j > i) j = (next() & mask) >>> 0;
    [order[i], order[j]] = [order[j], order[i]];
  }
  return order;
}

/* ---------------------------------------------------------------- pictures of one number a pixel */

/* Of each pixel, what `over` makes of the (before + 1 + after)^2 pixels about it that are there. */
function windowed(values, width, height, before, after, over) {
  const rows = values.slice();
  const found = values.slice();
  for (let y = 0, i = 0; y < height; y++) {
    for (let x = 0; x < width; x++, i++) {
      let value = values[i];
      for (let k = Math.max(-before, -x); k <= Math.min(after, width - 1 - x); k++)
        value = over(value, values[i + k]);
      rows[i] = value;
    }
  }
  for (let y = 0, i = 0; y < height; y++) {
    for (let x = 0; x < width; x++, i++) {
      let value = rows[i];
      for (let k = Math.max(-before, -y); k <= Math.min(after, height - 1 - y); k++)
        value = over(value, rows[i + k * width]);
      found[i] = value;
    }
  }
  return found;
}

const MOST = (a, b) => (a > b ? a : b);
const LEAST = (a, b) => (a < b ? a : b);

/* Bytes of 0 and 1, grown by so many pixels, where mask (if given) lets them. */
function dilated(shown, width, height, times, mask = null) {
  let found = shown;
  for (let k = 0; k < times; k++) {
    const grown = windowed(found, width, height, 1, 1, MOST);
    const now = found;
    found = grown.map((value, i) => (!mask || mask[i] ? value : now[i]));
  }
  return found;
}

/* Shrunk by so many pixels, as though nothing were shown beyond the border. */
function eroded(shown, width, height, times) {
  const found = windowed(shown, width, height, times, times, LEAST);
  for (let y = 0, i = 0; y < height; y++) {
    for (let x = 0; x < width; x++, i++) {
      if (Math.min(x, y, width - 1 - x, height - 1 - y) < times) found[i] = 0;
    }
  }
  return found;
}
