/* Where the light seems to be whose samples are none of the catalogue's: weights of points in its plane
   that explain the mean. */

const LATTICE = range(17).map((i) => -1.5 + 0.25 * i); // shares of the edges
const OFFSET = 1e-3; // of the right shadow ray [m]

/* misfit; points [s, t] and their weights; inside, the share of the weight on the light. null where the
   picture tells too little. */
function freeLight(view) {
  const found = view.heldAgainst(RIGHT_VARIANT);
  const seen = view.mean(view.value);
  const use = range(view.cells).filter((c) => seen[c] < 0.93 && view.counts[c] >= 8);
  if (use.length < 50) return null;
  const sd = use.map((c) =>
    Math.sqrt(found.noise[c] / view.counts[c] + square(0.004 * seen[c]) + square(0.25 / 255)),
  );
  const points = LATTICE.flatMap((t) => LATTICE.map((s) => [s, t]));
  const columns = points.map(([s, t]) => {
    const cells = view.mean(place(view, s, t));
    return Float64Array.from(use, (c, i) => cells[c] / sd[i]);
  });
  const wanted = Float64Array.from(use, (c, i) => seen[c] / sd[i]);
  const weights = nonNegative(columns, wanted);
  const misfits = wanted.map((value, i) => {
    const explained = columns.reduce((all, column, k) => all + (weights[k] ? weights[k] * column[i] : 0), 0);
    return Math.min(square(explained - value), 25);
  });
  const on = ([s, t]) => Math.abs(s - 0.5) <= 0.65 && Math.abs(t - 0.5) <= 0.65;
  const inside = sum(weights.map((weight, k) => (on(points[k]) ? weight : 0)));
  return {
    misfit: sum(misfits) / use.length,
    points,
    weights,
    inside: inside / Math.max(sum(weights), 1e-9),
  };
}

/* What each site would show, were all of the light's power at corner + s u + t v. */
function place({ scene, around, row }, s, t) {
  const { corner, u, v, area, normal } = scene.light;
  const at = along(along(corner, u, s), v, t);
  const { point, normal: facing } = around.moments.sites;
  const shown = new Float64Array(row.length);
  for (let i = 0; i < shown.length; i++) {
    const from = [point[3 * i], point[3 * i + 1], point[3 * i + 2]];
    const up = [facing[3 * i], facing[3 * i + 1], facing[3 * i + 2]];
    const way = minus(at, from);
    const d = length(way);
    const cs = dot(up, way) / d;
    const cl = dot(normal, way) / d;
    if (cs <= 0 || cl <= 0 || hides(scene, along(from, up, OFFSET), way, d)) continue;
    shown[i] = Math.min(((area * cs * cl) / (d * d)) * around.flatColour[i] * around.radiance[i], 1e6);
  }
  return shown;
}

/* Whether anything is on the way from an origin along `way`, of length d. */
function hides(scene, origin, way, d) {
  return scene.objects.some((thing) => {
    if (!thing.round) {
      const distance = (dot(thing.normal, minus(thing.point, origin)) * d) / dot(thing.normal, way);
      return distance > 0 && distance < d;
    }
    const to = minus(thing.center, origin);
    const middle = dot(to, way) / d;
    const root = middle * middle - (dot(to, to) - square(thing.radius));
    const half = Math.sqrt(Math.max(root, 0));
    return root > 0 && [middle - half, middle + half].some((end) => end > 0 && end < d);
  });
}

/* The weights, none negative, whose sum of columns is nearest to what is wanted (Lawson and Hanson 1974). */
function nonNegative(columns, wanted) {
  const inner = (a, b) => a.reduce((all, x, i) => all + x * b[i], 0);
  const products = columns.map((a, j) => columns.map((b, k) => (k <= j ? inner(a, b) : 0)));
  products.forEach((line, j) => line.forEach((_, k) => k > j && (line[k] = products[k][j])));
  const aims = columns.map((column) => inner(column, wanted));
  const weights = aims.map(() => 0);
  const free = new Set();
  const little = 1e-10 * Math.max(...aims.map(Math.abs));
  for (let round = 0; round < 3 * columns.length; round++) {
    const pull = aims.map((aim, j) => aim - sum([...free].map((k) => products[j][k] * weights[k])));
    const next = least(range(columns.length), (j) => (free.has(j) ? Infinity : -pull[j]));
    if (free.has(next) || pull[next] <= little) break;
    free.add(next);
    for (;;) {
      const which = [...free];
      const solved = solution(
        which.map((j) => which.map((k) => products[j][k])),
        which.map((j) => aims[j]),
      );
      if (solved.every((x) => x > 0)) {
        which.forEach((j, i) => (weights[j] = solved[i]));
        break;
      }
      // as far towards it as none turns negative
      const steps = solved.map((x, i) => (x > 0 ? 1 : weights[which[i]] / (weights[which[i]] - x)));
      const step = Math.min(...steps);
      which.forEach((j, i) => {
        weights[j] += step * (solved[i] - weights[j]);
        if (solved[i] <= 0 && steps[i] === step) {
          weights[j] = 0;
          free.delete(j);
        }
      });
    }
  }
  return weights;
}

/* Of a symmetric positive system, by Cholesky's factors. */
function solution(matrix, right) {
  const n = right.length;
  const factor = matrix.map((line) => line.slice());
  const found = right.slice();
  for (let j = 0; j < n; j++) {
    for (let k = 0; k < j; k++) for (let i = j; i < n; i++) factor[i][j] -= factor[i][k] * factor[j][k];
    const root = Math.sqrt(Math.max(factor[j][j], 1e-14 * matrix[j][j]));
    for (let i = j; i < n; i++) factor[i][j] /= root;
    factor[j][j] = root;
  }
  for (let j = 0; j < n; j++) {
    for (let k = 0; k < j; k++) found[j] -= factor[j][k] * found[k];
    found[j] /= factor[j][j];
  }
  for (let j = n - 1; j >= 0; j--) {
    for (let k = j + 1; k < n; k++) found[j] -= factor[k][j] * found[k];
    found[j] /= factor[j][j];
  }
  return found;
}
