/* How a student's camera rays go through the pixels, told from the background's outline alone. */

/* Where programs end their camera rays [m]. */
const CUTS = [5e4, 1e4, 2500, 1000, 500, 300, 200, 150, 120, 100, 90, 75, 50];
const SHIFT_CUTS = [5e4, 300, 200, 150, 75]; // those that a shift is looked for with
const LAB_CAMERAS = [0, -2]; // places on the z axis [m]
const PLACES = [
  [0.5, 0],
  [0.5, 1],
  [0, 0],
  [0, 1],
]; // position, divisor
const SAMPLE = 2500; // pixels near the outline that a search looks at

/* The ray of each pixel, against the scene's camera: position, the mean place of the ray in its pixel
   (0 corner, 0.5 centre); divisor, 1 where places are divided by W - 1, H - 1; jittered, a random
   place; cut, where rays end [m]; aspect, a horizontal stretch; moved, of the camera along its view
   axis [m]; flips, and shifts [pixels]. */
function sceneGrid(scene) {
  return {
    fovY: scene.camera.fovY,
    position: 0.5,
    divisor: 0,
    jittered: false,
    cut: scene.rayMaxDistance,
    aspect: 1,
    moved: 0,
    flipX: false,
    flipY: false,
    shiftX: 0,
    shiftY: 0,
  };
}

const cameraOf = (grid, scene) => ({
  ...scene.camera,
  position: along(scene.camera.position, scene.camera.forward, grid.moved),
  fovY: grid.fovY,
});

/* What the rays through the pixels (column, row) meet. */
function gridHits(grid, scene, column, row, width, height, cut = grid.cut, onlyObjects = false) {
  const n = column.length;
  const x = new Float64Array(n);
  const y = new Float64Array(n);
  for (let i = 0; i < n; i++) {
    const right = (column[i] + grid.shiftX + grid.position) * (width / (width - grid.divisor));
    const down = (row[i] + grid.shiftY + grid.position) * (height / (height - grid.divisor));
    x[i] = width / 2 + (right - width / 2) * ((grid.flipX ? -1 : 1) / grid.aspect);
    y[i] = grid.flipY ? height - down : down;
  }
  return cameraHits(scene, cameraOf(grid, scene), x, y, width, height, cut, onlyObjects);
}

/* Each deviation from the scene's camera: its code, the page's text for it, and values. */
function gridFacts(grid, scene) {
  const { fovY } = scene.camera;
  const stated = scene.rayMaxDistance;
  const said = [];
  const add = (code, text = code, values = {}) => said.push({ code, text, values });
  if (grid.position < 0.25) add("pixel_corner");
  if (grid.divisor) add("divided_by_w_minus_1");
  if (grid.jittered) add("jittered");
  if (grid.cut !== stated) add("ray_cut", grid.cut < 1000 ? "ray_cut" : "ray_far", { cut: grid.cut, stated });
  if (grid.shiftX || grid.shiftY) add("shift", "shift", { x: grid.shiftX, y: grid.shiftY });
  if (grid.fovY !== fovY) add("fov", "fov", { fov: grid.fovY, stated: fovY });
  if (grid.moved) add("camera_moved", grid.moved > 0 ? "forward" : "back", { moved: Math.abs(grid.moved) });
  if (grid.aspect !== 1) add("aspect", "aspect", { aspect: grid.aspect });
  if (grid.flipX) add("flip_x");
  if (grid.flipY) add("flip_y");
  return said;
}

/* The grid that explains the background's outline, and how many pixels near the outline it does not
   explain. Where nothing tells, the scene's own. */
function fitGrid(picture, scene) {
  const several = picture.pixelSamples > 1;
  const outline = new Outline(picture, scene);
  const coarse = picture.jpeg === "coarse";
  let grid = sceneGrid(scene),
    cost;
  if (outline.length === 0) return { grid: { ...grid, jittered: several }, miss: 0 };
  const jittered = several || outline.frayed > (coarse ? 0.08 : 0.008);
  // a random place is the centre on average
  const places = several || (jittered && !coarse) ? PLACES.slice(0, 2) : PLACES;
  const shifted = outline.shifted(...outline.placed(grid, places), places);
  if (shifted[1] < outline.tolerable) return { grid: { ...shifted[0], jittered }, miss: shifted[1] };
  [grid, cost] = outline.fit(grid, places);
  if (Math.abs(grid.fovY - scene.camera.fovY) > 1) {
    // a camera elsewhere with the scene's own field of view is the likelier of the two
    for (const moved of moves(scene)) {
      const [other, itsCost] = outline.placed({ ...sceneGrid(scene), moved }, places);
      if (itsCost < cost + 0.02 * outline.length) [grid, cost] = [other, itsCost];
    }
  }
  if (cost > 0.3 * outline.length) [grid, cost] = otherCamera(outline, grid, cost, scene, places);
  if (cost > 0.15 * outline.length) [grid, cost] = outline.shifted(grid, cost, places);
  return { grid: { ...grid, jittered }, miss: cost };
}

/* Flipped or stretched, if one of these explains the outline clearly better. */
function otherCamera(outline, grid, cost, scene, places) {
  const start = sceneGrid(scene);
  for (const flip of [{ flipY: true }, { flipX: true }, { flipX: true, flipY: true }]) {
    const variant = { ...start, ...flip };
    if (outline.rough(variant) < 0.8 * cost) {
      const [other, itsCost] = outline.fit(variant, places);
      if (itsCost < 0.6 * cost) [grid, cost] = [other, itsCost];
    }
  }
  if (cost > 0.3 * outline.length) {
    const [other, itsCost] = outline.stretched(grid, start.fovY, places);
    if (itsCost < 0.7 * cost) [grid, cost] = [other, itsCost];
  }
  return [grid, cost];
}

/* How far along the view axis the lab's other camera is, for a scene with one of the two. */
function moves({
  camera: {
    position: [x, y, z],
    forward,
  },
}) {
  if (x !== 0 || y !== 0 || String(forward) !== "0,0,1" || !LAB_CAMERAS.includes(z)) return [];
  return LAB_CAMERAS.filter((other) => other !== z).map((other) => other - z);
}

/* The pixels within 4 of the background's outline. Costs are pixels that a grid does not explain. */
class Outline {
  constructor(picture, scene) {
    const { background: shows, width, height } = picture;
    Object.assign(this, { scene, width, height });
    const inner = new Uint8Array(width * height);
    const at = (x, y) => shows[y * width + x];
    let notches = 0;
    for (let y = 0, p = 0; y < height; y++) {
      for (let x = 0; x < width; x++, p++) {
        const left = x > 0 && at(x - 1, y) !== shows[p];
        const up = y > 0 && at(x, y - 1) !== shows[p];
        if (left || up) inner[p] = 1;
        // unlike both neighbours in its row or column
        if (left && x + 1 < width && at(x + 1, y) !== shows[p]) notches++;
        if (up && y + 1 < height && at(x, y + 1) !== shows[p]) notches++;
      }
    }
    this.notches = notches;
    this.length = sum(inner); // pixels of the outline itself
    const near = dilated(inner, width, height, 4);
    const pixels = range(width * height).filter((p) => near[p]);
    this.all = this.pixels(pixels, shows);
    const thin = permutation(pixels.length)
      .slice(0, SAMPLE)
      .sort((a, b) => a - b);
    this.thin = this.pixels(
      thin.map((i) => pixels[i]),
      shows,
    );
    const step = Math.max(1, Math.floor(height / 40));
    const half = Math.floor(step / 2);
    const whole = [];
    for (let y = half; y < height; y += step)
      for (let x = half; x < width; x += step) whole.push(y * width + x);
    this.lattice = this.pixels(whole, shows); // of the whole picture, for a camera that is far off
  }

  pixels(which, shows) {
    return {
      column: Float64Array.from(which, (p) => p % this.width),
      row: Float64Array.from(which, (p) => Math.floor(p / this.width)),
      seen: which.map((p) => shows[p]),
    };
  }

  wrong(grid, { column, row, seen }) {
    const { object } = gridHits(grid, this.scene, column, row, this.width, this.height, grid.cut, true);
    let count = 0;
    for (let i = 0; i < seen.length; i++) if ((object[i] === BACKGROUND) !== Boolean(seen[i])) count++;
    return count;
  }

  unexplained = (grid) => this.wrong(grid, this.all);

  /* unexplained(), as some of the pixels tell */
  sampled = (grid) =>
    Math.round((this.wrong(grid, this.thin) * this.all.seen.length) / this.thin.seen.length);

  /* Least cost over wide fields of view: a bound on how well such a grid may do. */
  rough(grid) {
    return Math.min(
      ...this.wide(grid)
        .slice(0, 3)
        .map((fovY) => this.sampled({ ...grid, fovY })),
    );
  }

  /* Pixels that the right grid may leave unexplained, more where the outline is frayed. */
  get tolerable() {
    return 0.04 * this.length + 2.5 * this.notches;
  }

  /* Of the outline, how much are notches: a tenth where rays are random, else almost none. */
  get frayed() {
    return this.notches / this.length;
  }

  /* Field of view, place in the pixel and ray cut. The grid's own field of view is kept unless
     another is clearly better. */
  fit(grid, places) {
    const [own, ownCost] = this.placed(grid, places);
    if (ownCost < this.tolerable) return [own, ownCost];
    const starts = this.wide(grid).flatMap((fovY) => [grid.cut, 5e4].map((cut) => ({ ...grid, fovY, cut })));
    const start = least(starts, this.sampled);
    // each place with a field of view of its own: a corner over W - 1 is nearly a centre over W that
    // is seen a little narrower
    const found = places.map((place) => this.placed(this.focused(start, place), [place]));
    const [best, cost] = least(found, (result) => result[1]);
    return cost < ownCost - 0.04 * this.length ? [best, cost] : [own, ownCost];
  }

  /* Fields of view near which the right one is, if one is: best first. */
  wide(grid) {
    const half = Math.tan(radians(grid.fovY) / 2);
    const fovs = geometric(0.2, 5, 65).map((k) => degrees(2 * Math.atan(half * k)));
    return sorted(fovs, (fovY) => this.wrong({ ...grid, fovY }, this.lattice)).slice(0, 5);
  }

  /* Field of view to 0.03 degrees, and the ray cut along with it. */
  focused(grid, [position, divisor]) {
    grid = { ...grid, position, divisor };
    for (const step of [0.5, 0.12, 0.03]) {
      const cuts = [...new Set([grid.cut, this.scene.rayMaxDistance, 5e4])].sort((a, b) => a - b);
      const choices = range(9)
        .map((k) => grid.fovY + step * (k - 4))
        .filter((fovY) => fovY > 1 && fovY < 175)
        .flatMap((fovY) => cuts.map((cut) => ({ ...grid, fovY: Math.round(1000 * fovY) / 1000, cut })));
      grid = least(choices, this.sampled);
    }
    return grid;
  }

  /* Place in the pixel and ray cut, the scene's own first. */
  placed(grid, places) {
    const own = this.scene.rayMaxDistance;
    let choices = [own, ...CUTS].flatMap((cut) =>
      places.map(([position, divisor]) => ({ ...grid, position, divisor, cut })),
    );
    choices = sorted(choices, this.sampled).slice(0, 6);
    // an outline frayed by random places is so by chance: what is odd must be clearly better
    const chance = places.length === 2 ? 0.5 * this.notches : 0;
    const results = choices.map((choice) => [choice, this.unexplained(choice)]);
    return least(
      results,
      ([choice, cost]) => cost + chance * ((choice.cut !== own) + (choice.divisor !== 0)),
    );
  }

  /* Aspect ratio and field of view. */
  stretched(grid, fov, places) {
    const half = Math.tan(radians(fov) / 2);
    const fovs = [fov, grid.fovY, ...geometric(0.4, 2.5, 25).map((k) => degrees(2 * Math.atan(half * k)))];
    let choices = fovs.flatMap((fovY) => geometric(0.5, 2, 17).map((aspect) => ({ ...grid, fovY, aspect })));
    choices = sorted(choices, (choice) => this.wrong(choice, this.lattice)).slice(0, 12);
    let best = least(choices, this.sampled);
    const steps = [-3, -2, -1, 0, 1, 2, 3];
    for (const step of [0.03, 0.01, 0.003]) {
      const near = best;
      choices = steps.flatMap((j) =>
        steps.map((k) => ({
          ...near,
          fovY: near.fovY + 25 * step * j,
          aspect: near.aspect * (1 + step * k),
        })),
      );
      best = least(choices, this.sampled);
    }
    const ratio = this.width / this.height;
    const known = [ratio, 1 / ratio, best.aspect].flatMap((aspect) =>
      [fov, best.fovY].map((fovY) => ({ ...best, aspect, fovY })),
    );
    return least(
      known.map((choice) => this.placed(choice, places)),
      ([choice, cost]) =>
        cost + 0.02 * this.length * ((choice.fovY !== fov) + (choice.aspect === best.aspect)),
    );
  }

  /* Shifts of up to two pixels, if one explains the outline clearly better. */
  shifted(grid, cost, places) {
    if (cost < this.tolerable) return [grid, cost];
    const steps = [-2, -1, 0, 1, 2];
    let choices = [this.scene.rayMaxDistance, ...SHIFT_CUTS].flatMap((cut) =>
      steps.flatMap((shiftX) =>
        steps.map((shiftY) => ({ ...grid, position: 0.5, divisor: 0, cut, shiftX, shiftY })),
      ),
    );
    choices = sorted(choices, this.sampled).slice(0, 3);
    const [best, itsCost] = least(
      choices.map((choice) => this.placed(choice, places)),
      (result) => result[1],
    );
    return itsCost < 0.6 * cost ? [best, itsCost] : [grid, cost];
  }
}
