/* A picture laid over its scene: which pixels tell of the light, and cells of them. Two statistics a
   cell, each held against what a renderer (a variant) foretells: the mean's residual, and the noise
   within the cell. docs/check.md derives it. */

const CELL = 8; // a cell's side [pixels]
const THIN = 2; // where nothing happens cells are so many times larger, of every such pixel
const RIM = 3; // pixels so near to another object are left out
const FAR = 0.6; // what lies beyond this part of the rays' length is left out
const MOST_CELLS = 900;
const NU = 5; // Student's t: how little a cell that no model explains may weigh
const RELATIVE = 2e-3; // tolerance of the mean
const NOISE = 0.15; // of the noise's variance, as a logarithm
const SMOOTHED = 0.35; // what halved colours leave of a pure colour's noise
const SLOPE_GRID = 6; // squared, points of the light by which the slope of a penumbra is known
const FEW_EVENTS = 8;
const SPARED = 0.8; // part of the foretold variance below which samples are better spread than random ones
const SHIFT = 0.1; // what rays may be beside where the grid has them [pixels]
const SHIFT_FITTED = 0.25; // where the grid is no camera that the scene has but one that was fitted
const FEW = 6; // pixels without which a cell tells no noise
const STD = "std std std";

/* What one light sample does on average at some sites under each mistake, computed when asked for by
   the library of mistakes, and kept: of a key "domain visibility weight" the chance that a sample
   sees the light, and the means of V w and V w^2 [sr, sr^2]. */
class Moments {
  constructor(library, sites, grid) {
    Object.assign(this, { library, sites, grid, table: new Map() });
  }

  /* Compute those that are not there yet: of a domain all rays with all weights. */
  async prepare(keys) {
    const missing = keys.filter((key) => !this.table.has(key)).map((key) => key.split(" "));
    for (const domain of new Set(missing.map((key) => key[0]))) {
      const wanted = missing.filter((key) => key[0] === domain);
      const [rays, weights] = [1, 2].map((i) => [...new Set(wanted.map((key) => key[i]))]);
      const { chance, first, second } = await this.library(this.sites, domain, rays, weights, this.grid);
      const n = this.sites.object.length;
      const row = (array, i) => array.subarray(i * n, (i + 1) * n);
      rays.forEach((ray, r) =>
        weights.forEach((weight, w) => {
          const i = r * weights.length + w;
          this.table.set(`${domain} ${ray} ${weight}`, {
            chance: row(chance, r),
            first: row(first, i),
            second: row(second, i),
          });
        }),
      );
    }
  }

  get(key) {
    return this.table.get(key);
  }
}

/* Of rows of `size` numbers a site, those of some sites. */
function taken(array, which, size = 1) {
  const found = new array.constructor(size * which.length);
  for (let k = 0; k < which.length; k++) {
    for (let c = 0; c < size; c++) found[size * k + c] = array[size * which[k] + c];
  }
  return found;
}

const takenSites = (sites, which) => ({
  object: taken(sites.object, which),
  inside: taken(sites.inside, which),
  ...Object.fromEntries(
    ["point", "normal", "right", "down"].map((name) => [name, taken(sites[name], which, 3)]),
  ),
});

class View {
  /* library(sites, domain, rays, weights, grid): the library of mistakes' moments. */
  static async of(picture, grid, scene, library, lightGrid) {
    const view = Object.assign(new View(), { picture, grid, scene, quick: false });
    await view.chooseSites(library);
    await view.look(library, lightGrid);
    view.count();
    return view;
  }

  /* Row, column and cell of the pixels that tell: all where shadows may fall, one in THIN^2
     elsewhere, none at an object's rim or far away. */
  async chooseSites(library) {
    const {
      scene,
      grid,
      picture: { width, height },
    } = this;
    const n = width * height;
    const column = Float64Array.from({ length: n }, (_, p) => p % width);
    const row = Float64Array.from({ length: n }, (_, p) => Math.floor(p / width));
    const hits = gridHits(grid, scene, column, row, width, height, Infinity);
    const most = windowed(hits.object, width, height, RIM, RIM, MOST);
    const lowest = windowed(hits.object, width, height, RIM, RIM, LEAST);
    const camera = cameraOf(grid, scene).position;
    const cut = Math.min(grid.cut, scene.rayMaxDistance);
    const usable = new Uint8Array(n);
    for (let p = 0; p < n; p++) {
      usable[p] =
        most[p] === lowest[p] && hits.object[p] >= 0 && distanceTo(hits.point, p, camera) < FAR * cut ? 1 : 0;
    }
    const busy = await this.busy(library, hits, usable);
    const large = CELL * THIN;
    const kinds = scene.objects.length + 1;
    const kept = [];
    const cells = [];
    for (let p = 0; p < n; p++) {
      const x = column[p];
      const y = row[p];
      if (!usable[p] || !(busy[p] || (y % THIN === 0 && x % THIN === 0))) continue;
      const side = busy[p] ? CELL : large;
      kept.push(p);
      cells.push(
        Math.floor(y / side) * (width + 1) +
          Math.floor(x / side) +
          (width + 1) * (height + 1) * (hits.object[p] + 1 + kinds * busy[p]),
      );
    }
    const cell = ranks(cells);
    const number = cell.length ? largest(cell) + 1 : 0;
    let chosen = range(kept.length);
    if (number > MOST_CELLS) {
      const some = new Uint8Array(number);
      for (const k of permutation(number).slice(0, MOST_CELLS)) some[k] = 1;
      chosen = chosen.filter((i) => some[cell[i]]);
    }
    this.row = Int32Array.from(chosen, (i) => row[kept[i]]);
    this.column = Int32Array.from(chosen, (i) => column[kept[i]]);
    this.cell = Int32Array.from(chosen, (i) => cell[i]);
  }

  /* Where a light may be seen in part, be it by a renderer with a large offset or with samples
     beside the light. */
  async busy(library, hits, usable) {
    const { width, height } = this.picture;
    const step = 4;
    const where = [];
    for (let y = 0; y < height; y += step)
      for (let x = 0; x < width; x += step) if (usable[y * width + x]) where.push(y * width + x);
    const sites = takenSites(
      { ...hits, right: new Float64Array(hits.point.length), down: new Float64Array(hits.point.length) },
      where,
    );
    const moments = new Moments(library, sites, 6);
    const keys = [STD, "std offset_0_5 std", "about_corner_double std std"];
    await moments.prepare([...keys, "std none std", "std none no_receiver_cosine"]);
    const spread = new Uint8Array(width * height);
    const full = moments.get("std none std").first;
    const top = moments.get("std none no_receiver_cosine").first;
    where.forEach((p, i) => {
      const partly = keys.some((key) => {
        const { chance, first } = moments.get(key);
        return chance[i] > 0.001 && (chance[i] < 0.999 || !(first[i] > 0));
      });
      const terminator = full[i] > 0 && full[i] < Math.fround(0.35) * top[i];
      spread[p] = partly || terminator ? 1 : 0;
    });
    const near = windowed(spread, width, height, step, step, MOST);
    const cells = windowed(near, width, height, CELL / 2, CELL / 2 - 1, MOST);
    const side = CELL * THIN;
    const columns = Math.ceil(width / side);
    const blocks = new Uint8Array(columns * Math.ceil(height / side));
    const block = (p) => Math.floor(Math.floor(p / width) / side) * columns + Math.floor((p % width) / side);
    cells.forEach((shown, p) => {
      if (shown) blocks[block(p)] = 1;
    });
    return cells.map((_, p) => blocks[block(p)]);
  }

  async look(library, lightGrid) {
    const {
      scene,
      grid,
      picture,
      picture: { width, height },
    } = this;
    const sites = sitesAt(scene, grid, this.column, this.row, width, height);
    const n = this.row.length;
    this.objectId = sites.object;
    const foretold = scene.objects.map((thing) => thing.color.map((c, k) => c * scene.light.radiance[k]));
    this.recoloured = this.recolouredObjects(foretold);
    /* Where an object lacks the scene's main channel, its own brightest one is looked at instead. */
    this.channels = scene.objects.map((thing, i) => {
      const colour = this.recoloured[thing.name];
      const channel = foretold[i].indexOf(Math.max(...foretold[i]));
      return colour && colour[channel] < 0.5 ? colour.indexOf(Math.max(...colour)) : channel;
    });
    const recoloured = Object.keys(this.recoloured).length > 0;
    const ofSite = (value) =>
      Float64Array.from(this.objectId, (object) => value(scene.objects[object], this.channels[object]));
    this.value = Float64Array.from(
      this.row,
      (row, i) =>
        picture.value[picture.levels[4 * (row * width + this.column[i]) + this.channels[this.objectId[i]]]],
    );
    const camera = cameraOf(grid, scene).position;
    this.around = {
      light: scene.light,
      moments: new Moments(library, sites, lightGrid),
      flatColour: ofSite((thing, channel) => (recoloured ? Math.max(...thing.color) : thing.color[channel])),
      radiance: ofSite((_, channel) => scene.light.radiance[channel]),
      background: ofSite((_, channel) => scene.background[channel]),
      distance: Float64Array.from({ length: n }, (_, i) => distanceTo(sites.point, i, camera)),
      slope: await slopeOf(scene, sites, library),
    };
    await this.around.moments.prepare([STD]);
  }

  /* Objects whose colour in the picture is another than the scene's, and which it is, the largest
     channel 1. */
  recolouredObjects(foretold) {
    const { picture } = this;
    const found = {};
    this.scene.objects.forEach((thing, i) => {
      const shares = [[], [], []];
      for (let k = 0; k < this.row.length; k++) {
        if (this.objectId[k] !== i) continue;
        const at = 4 * (this.row[k] * picture.width + this.column[k]);
        const seen = [0, 1, 2].map((c) => picture.value[picture.levels[at + c]]);
        const top = Math.max(...seen);
        if (top > 0.1 && top < 0.95) seen.forEach((v, c) => shares[c].push(v / top));
      }
      if (shares[0].length < 50) return;
      const colour = shares.map(median);
      const most = Math.max(...foretold[i], 1e-9);
      if (colour.some((c, k) => Math.abs(c - foretold[i][k] / most) > 0.25)) {
        found[thing.name] = colour.map((c) => c / Math.max(...colour, 1e-9));
      }
    });
    return found;
  }

  count() {
    this.cell = ranks(this.cell);
    this.cells = this.cell.length ? largest(this.cell) + 1 : 0;
    this.counts = new Float64Array(this.cells);
    for (const cell of this.cell) this.counts[cell]++;
    this.tellsNoise = this.tells();
  }

  /* Every share-th cell, its moments computed anew with lightGrid squared points. */
  async part(share, lightGrid) {
    const which = range(this.row.length).filter((i) => this.cell[i] % share === 0);
    const { around } = this;
    const part = Object.assign(new View(), this, { quick: true });
    for (const name of ["row", "column", "cell", "objectId", "value"]) part[name] = taken(this[name], which);
    part.around = {
      ...around,
      moments: new Moments(around.moments.library, takenSites(around.moments.sites, which), lightGrid),
    };
    for (const name of ["flatColour", "radiance", "background", "distance", "slope"])
      part.around[name] = taken(around[name], which);
    await part.around.moments.prepare([STD]);
    part.count();
    return part;
  }

  predict(variant) {
    const { picture } = this;
    return predict(
      this.around,
      variant,
      picture.lightSamples,
      picture.pixelSamples,
      this.grid.jittered,
      this.quick,
    );
  }

  /* Of each cell. */
  mean(values) {
    const means = new Float64Array(this.cells);
    for (let i = 0; i < values.length; i++) means[this.cell[i]] += values[i];
    return means.map((total, c) => total / this.counts[c]);
  }

  /* Of every cell, observed against a law: residual, the mean of observed - foretold, and its
     variance with the tolerance; noise, observed and foretold within the cell, the logarithm of their
     ratio and its variance (Infinity where the cell is too small to tell); mean, foretold. */
  statistics(law) {
    const { picture, around, cell, value, counts, cells } = this;
    const step = picture.quantisationVariance;
    const of = () => new Float64Array(cells);
    const meanResidual = of();
    const residualSquare = of();
    const ends = of();
    const foretold = of();
    const shownMean = of();
    const beside = of();
    for (let i = 0; i < value.length; i++) {
      const c = cell[i];
      const mean = law.mean[i];
      const variance = law.variance[i];
      // 8 bits: black below a step
      const shown = mean < 1 / 255 && variance < square(0.3 / 255) ? 0 : Math.min(mean, 1);
      const off = value[i] - shown;
      meanResidual[c] += off;
      residualSquare[c] += off * off;
      ends[c] += mean > 1 - 1e-6 || mean < 1e-6 ? 1 : 0;
      foretold[c] += variance;
      shownMean[c] += shown;
      beside[c] += Math.sqrt(12 * around.slope[i]) * shown;
    }
    const coarse = picture.jpeg === "coarse";
    const [floor, absolute] = this.tolerances();
    const found = {
      residual: of(),
      residualVariance: of(),
      noise: of(),
      foretoldNoise: of(),
      noiseRatio: of(),
      noiseVariance: of(),
      mean: of(),
    };
    for (let c = 0; c < cells; c++) {
      const n = counts[c];
      const off = meanResidual[c] / n;
      const mean = shownMean[c] / n;
      const variance = foretold[c] / n;
      const quantised = step * (1 - ends[c] / n);
      const shared = law.correlation === "ALL" ? n : law.correlation === "ROW" ? Math.sqrt(n) : 1;
      let inside =
        law.correlation === "ALL"
          ? 0.03 * variance
          : law.correlation === "ROW"
            ? variance * (1 - 1 / Math.sqrt(n))
            : variance;
      inside = inside * (coarse ? SMOOTHED : 1) + quantised;
      found.residual[c] = off;
      found.residualVariance[c] =
        (variance * shared) / n +
        quantised / n +
        square(RELATIVE * mean) +
        square(absolute) +
        square((this.shift * beside[c]) / n);
      found.noise[c] = ((residualSquare[c] / n - off * off) * n) / Math.max(n - 1, 1);
      found.foretoldNoise[c] = inside;
      found.noiseRatio[c] = Math.log((found.noise[c] + floor) / (inside + floor));
      let wide = law.correlation === "ALL" || coarse ? 1 : square(NOISE);
      // a cell may have none of those pixels, or many
      if (law.rare > 0.01) wide += Math.min(1 / (law.rare * Math.max(n, 1)), 1);
      found.noiseVariance[c] = this.tellsNoise[c] ? (2 * 1.5) / Math.max(n - 1, 1) + wide : Infinity;
      found.mean[c] = mean;
    }
    return found;
  }

  /* Whether the scatter in each cell is a variance. It is not where only a few samples are expected
     to be hidden among visible ones, or visible among hidden ones. */
  tells() {
    const { picture, counts } = this;
    const drawn = picture.lightSamples * picture.pixelSamples;
    const { chance } = this.around.moments.get(STD);
    const events = this.mean(chance.map((p) => Math.min(p, 1 - p))).map(
      (share, c) => share * drawn * counts[c],
    );
    return Uint8Array.from(counts, (n, c) =>
      n >= FEW && !(events[c] > 0 && events[c] < FEW_EVENTS) ? 1 : 0,
    );
  }

  get shift() {
    const { grid, scene } = this;
    const own = grid.fovY === scene.camera.fovY && grid.aspect === 1;
    return own && !grid.shiftX && !grid.shiftY ? SHIFT : SHIFT_FITTED;
  }

  /* Of the noise's variance and of the mean, absolute. */
  tolerances() {
    const jpeg = this.picture.jpeg !== "";
    return [square((jpeg ? 1 : 0.5) / 255), (0.25 * (jpeg ? 3 : 1)) / 255];
  }

  heldAgainst(variant) {
    return this.statistics(this.predict(variant));
  }

  /* Log-likelihood of every cell; loose: if the mean may be off by so much, relative; sparedNoise:
     noise that is lower than foretold by one factor is a better sampler, no fault. */
  loglik(found, sparedNoise, loose = 0) {
    const ratio = sparedNoise ? this.spared(found) : found.noiseRatio;
    return found.residual.map((residual, c) => {
      const most = Math.max(found.mean[c], found.mean[c] + residual);
      const s2 = found.residualVariance[c] + (loose ? square(loose * most) + square(loose / 30) : 0);
      const noise = found.noiseVariance[c];
      return (
        -0.5 * (NU + 1) * Math.log1p((residual * residual) / s2 / NU) -
        0.5 * Math.log(s2) -
        (noise < Infinity
          ? 0.5 * (NU + 1) * Math.log1p(square(ratio[c]) / noise / NU) + 0.5 * Math.log(noise)
          : 0)
      );
    });
  }

  /* Expected log-likelihood of one above two's where one is the truth. */
  apart(one, two) {
    const [floor] = this.tolerances();
    let total = 0;
    for (let c = 0; c < this.cells; c++) {
      const shift = square(one.mean[c] - two.mean[c]) / two.residualVariance[c];
      const noise = two.noiseVariance[c];
      const louder =
        noise < Infinity
          ? square(Math.log((one.foretoldNoise[c] + floor) / (two.foretoldNoise[c] + floor))) / noise
          : 0;
      total += 0.5 * (NU + 1) * (Math.log1p(shift / NU) + Math.log1p(louder / NU));
    }
    return total;
  }

  /* Noise ratios, but 0 where samples are better spread than random ones, which is where the noise of
     most cells is lower than foretold. Cells of little noise and of much are asked apart. */
  spared(found) {
    const ratio = found.noiseRatio.slice();
    for (const loud of [true, false]) {
      const kind = range(this.cells).filter(
        (c) =>
          found.foretoldNoise[c] > square(0.02 * found.mean[c]) === loud &&
          found.mean[c] > 0.01 &&
          found.noiseVariance[c] < Infinity,
      );
      if (kind.length > 10 && median(kind.map((c) => ratio[c])) < Math.log(SPARED))
        for (const c of kind) ratio[c] = 0;
    }
    return ratio;
  }

  /* The brightness that fits the picture best, from cells away from the ends. */
  bestFactor(variant) {
    let { factor } = variant;
    const seen = this.mean(this.value);
    for (let round = 0; round < 3; round++) {
      const foretold = this.mean(this.predict({ ...variant, factor }).mean);
      let fine = range(this.cells).filter(
        (c) => foretold[c] > 0.03 && foretold[c] < 0.93 && seen[c] < 0.93 && seen[c] > 0.03,
      );
      if (fine.length < 20)
        fine = range(this.cells).filter((c) => foretold[c] > 0.01 && seen[c] < 0.97 && seen[c] > 0.01);
      if (fine.length < 20) return factor;
      factor *= clip(median(fine.map((c) => seen[c] / foretold[c])), 0.05, 20);
    }
    return factor;
  }
}

/* ---------------------------------------------------------------- sites */

/* The place of each number among the different ones, from 0. */
function ranks(numbers) {
  const order = new Map([...new Set(numbers)].sort((a, b) => a - b).map((number, i) => [number, i]));
  return Int32Array.from(numbers, (number) => order.get(number));
}

function distanceTo(point, i, place) {
  return Math.hypot(point[3 * i] - place[0], point[3 * i + 1] - place[1], point[3 * i + 2] - place[2]);
}

/* What the rays through the pixels meet, and how far it moves in half a pixel. */
function sitesAt(scene, grid, column, row, width, height) {
  const hits = gridHits(grid, scene, column, row, width, height, Infinity);
  const moved = (dx, dy) => {
    const { point } = gridHits(
      grid,
      scene,
      Float64Array.from(column, (x) => x + dx),
      Float64Array.from(row, (y) => y + dy),
      width,
      height,
      Infinity,
    );
    return point.map((x, i) => x - hits.point[i]);
  };
  return { ...hits, right: moved(0.5, 0), down: moved(0, 0.5) };
}

/* (dE/dx)^2 + (dE/dy)^2 over 12 E^2: relative variance of the irradiance under a uniform place in the
   pixel. */
async function slopeOf(scene, sites, library) {
  const n = sites.object.length;
  const around = [];
  for (const [step, sign] of [
    [sites.right, 1],
    [sites.right, -1],
    [sites.down, 1],
    [sites.down, -1],
  ]) {
    const point = sites.point.map((x, i) => x + sign * step[i]);
    const normal = sites.normal.slice();
    for (let i = 0; i < n; i++) {
      const thing = scene.objects[sites.object[i]];
      if (thing.round && !sites.inside[i])
        for (let c = 0; c < 3; c++) normal[3 * i + c] = (point[3 * i + c] - thing.center[c]) / thing.radius;
    }
    const moments = new Moments(library, { ...sites, point, normal }, SLOPE_GRID);
    await moments.prepare([STD]);
    around.push(moments.get(STD).first);
  }
  return Float64Array.from({ length: n }, (_, i) => {
    const [right, left, below, above] = around.map((total) => Math.max(total[i], 1e-9));
    const middle = (right + left + below + above) / 4;
    return Math.min((square((right - left) / middle) + square((below - above) / middle)) / 12, 0.3);
  });
}
