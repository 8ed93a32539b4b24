/* A student's picture as numbers: linear values, what is clipped, where the background shows; and
   what the rays of a camera meet in the scene. */

const BACKGROUND = -1;
const LUMA = [0.299, 0.587, 0.114]; // JPEG's brightness of red, green and blue
const TOP = 255;
const ROUNDED = ", rounded";
const EITHER = ", rounded or not";

const srgb = (v) => (v <= 0.0031308 ? 12.92 * v : 1.055 * Math.pow(v, 1 / 2.4) - 0.055);
const srgbBack = (v) => (v <= 0.04045 ? v / 12.92 : Math.pow((v + 0.055) / 1.055, 2.4));
/* Of a curve between linear values and what is stored, in [0, 1]: there, and back. */
const GAMMAS = {
  "gamma 2.2": [(v) => Math.pow(v, 1 / 2.2), (e) => Math.pow(e, 2.2)],
  sRGB: [srgb, srgbBack],
  "square root": [Math.sqrt, square],
  "gamma twice": [(v) => Math.pow(v, 1 / square(2.2)), (e) => Math.pow(e, square(2.2))],
};

/* ---------------------------------------------------------------- the scene */

const along = (a, b, k) => [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]];
const minus = (a, b) => along(a, b, -1);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const length = (a) => Math.sqrt(dot(a, a));
const unit = (a) => a.map((x) => x / length(a));

/* A scene file's JSON, of spheres and planes under one quad, as the check wants it. */
function readScene(json) {
  const { position, look_at, up, fov_y_deg } = json.camera;
  const [quad] = json.quad_lights;
  const forward = unit(minus(look_at, position));
  const right = unit(cross(unit(up), forward));
  const area = length(cross(quad.u, quad.v));
  return {
    name: json.name,
    camera: { position, forward, right, up: cross(forward, right), fovY: fov_y_deg },
    objects: [
      ...json.spheres.map((s) => ({ ...s, round: true })),
      ...json.planes.map((p) => ({ ...p, normal: unit(p.normal) })),
    ],
    light: {
      corner: quad.position,
      u: quad.u,
      v: quad.v,
      normal: unit(cross(quad.u, quad.v)),
      area,
      norms: length(quad.u) * length(quad.v),
      radiance: quad.color.map((c) => c * quad.power),
    },
    background: json.background,
    rayMaxDistance: json.ray_max_distance,
  };
}

/* What the rays through the image points x, y [pixels] meet within `cut` [m]: object (its number, or
   BACKGROUND), and, unless only that is asked for, point and normal, three numbers each. */
function cameraHits(scene, camera, x, y, width, height, cut, onlyObjects = false) {
  const n = x.length;
  const object = new Int32Array(n).fill(BACKGROUND);
  const inside = new Uint8Array(n);
  const point = onlyObjects ? null : new Float64Array(3 * n);
  const normal = onlyObjects ? null : new Float64Array(3 * n);
  const { position, forward, right, up } = camera;
  const half = Math.tan(radians(camera.fovY) / 2);
  const across = (half * width) / height;
  const things = scene.objects.map((thing) => {
    const to = thing.round ? minus(thing.center, position) : minus(thing.point, position);
    return {
      thing,
      to,
      constant: thing.round
        ? (length(to) - thing.radius) * (length(to) + thing.radius)
        : dot(thing.normal, to),
    };
  });
  for (let i = 0; i < n; i++) {
    const a = ((2 * x[i]) / width - 1) * across;
    const b = (1 - (2 * y[i]) / height) * half;
    let dx = forward[0] + a * right[0] + b * up[0];
    let dy = forward[1] + a * right[1] + b * up[1];
    let dz = forward[2] + a * right[2] + b * up[2];
    const size = Math.sqrt(dx * dx + dy * dy + dz * dz);
    dx /= size;
    dy /= size;
    dz /= size;
    let nearest = Infinity;
    for (let k = 0; k < things.length; k++) {
      const { thing, to, constant } = things[k];
      let distance,
        leaves = false;
      if (thing.round) {
        const middle = dx * to[0] + dy * to[1] + dz * to[2];
        const px = to[0] - middle * dx;
        const py = to[1] - middle * dy;
        const pz = to[2] - middle * dz;
        const discriminant = thing.radius * thing.radius - (px * px + py * py + pz * pz);
        if (discriminant < 0) continue;
        const q = middle + (middle < 0 ? -1 : 1) * Math.sqrt(discriminant);
        const other = constant / q;
        const near = Math.min(q, other);
        const far = Math.max(q, other);
        leaves = near <= 0;
        distance = leaves ? far : near;
      } else {
        distance = constant / (dx * thing.normal[0] + dy * thing.normal[1] + dz * thing.normal[2]);
      }
      if (distance > 0 && distance < nearest && distance <= cut) {
        nearest = distance;
        object[i] = k;
        inside[i] = leaves ? 1 : 0;
      }
    }
    if (onlyObjects) continue;
    const met = object[i] !== BACKGROUND;
    const direction = [dx, dy, dz];
    let at = along(position, direction, met ? nearest : 0);
    let facing = [0, 0, 0];
    if (met) {
      const thing = scene.objects[object[i]];
      facing = thing.round ? unit(minus(at, thing.center)) : thing.normal;
      at = thing.round
        ? along(thing.center, facing, thing.radius)
        : along(at, facing, -dot(minus(at, thing.point), facing));
      if (thing.round ? inside[i] : dot(facing, direction) > 0) facing = facing.map((c) => -c);
    }
    point.set(at, 3 * i);
    normal.set(facing, 3 * i);
  }
  return { object, point, normal, inside };
}

/* ---------------------------------------------------------------- the picture */

/* levels: RGBA bytes; jpeg: "", "fine", "coarse". The background, of which the scene's radiance is
   known, tells how the file's numbers stand for values; without it they are taken as the lab writes
   them, times 255 and truncated. */
function readPicture({ levels, width, height, jpeg }, scene, lightSamples, pixelSamples) {
  const { colour, law, facts } = background(levels, width, height, jpeg, scene);
  const tolerance = { "": 0, fine: 3, coarse: 12 }[jpeg];
  const margin = { "": 0, fine: 1, coarse: 3 }[jpeg];
  const mixed = jpeg !== "" || pixelSamples > 1;
  const shows = colour
    ? flat(levels, width, height, colour, tolerance, mixed, jpeg === "coarse")
    : new Uint8Array(width * height);
  const value = range(256).map((level) =>
    level <= margin ? 0 : level >= TOP - margin ? 1 : decoded(level, law),
  );
  const slope = range(256).map((level) => square(decoded(level + 0.5, law) - decoded(level - 0.5, law)));
  let steep = 0;
  let count = 0;
  for (let i = 0; i < levels.length; i++) {
    if (i % 4 < 3 && levels[i] < TOP - margin) {
      steep += slope[levels[i]];
      count++;
    }
  }
  const steepness = count ? steep / count : 1 / square(TOP);
  return {
    levels,
    width,
    height,
    jpeg,
    facts,
    lightSamples,
    pixelSamples,
    value: Float64Array.from(value), // of each level; 1 where it is clipped at the top
    background: shows,
    law: law.split(",")[0],
    quantisationVariance: (1 / 12 + { "": 0, fine: 0.35, coarse: 4 }[jpeg]) * steepness,
  };
}

/* The levels that a value may have in a file, by law; the likeliest law first. */
function encoded(value) {
  const of = (make) => value.map(make);
  const curves = Object.entries(GAMMAS).map(([name, [curve]]) => [name, curve]);
  const laws = [
    ["truncated", of((v) => Math.floor(v * TOP))],
    ["rounded", of((v) => Math.floor(v * TOP + 0.5))],
    ["truncated 256", of((v) => Math.min(Math.floor(v * (TOP + 1)), TOP))],
  ];
  for (const [name, curve] of [...curves, ["gamma twice", (v) => srgb(srgb(v))]]) {
    laws.push([name, of((v) => Math.floor(curve(v) * TOP))]);
    laws.push([name + ROUNDED, of((v) => Math.floor(curve(v) * TOP + 0.5))]);
    laws.push([name + ROUNDED, of((v) => Math.min(Math.floor(curve(v) * (TOP + 1)), TOP))]);
  }
  return laws;
}

/* The middle of the values that give a level. */
function decoded(level, law) {
  if (law === "rounded" + EITHER) return (level + 0.25) / (TOP + 0.5);
  if (law === "rounded") return level / TOP;
  if (law === "truncated 256") return (level + 0.5) / (TOP + 1);
  const [curve, rounding] = law.split(",");
  const stored = Math.max(
    (level + (rounding === undefined ? 0.5 : "," + rounding === ROUNDED ? 0 : 0.25)) / TOP,
    0,
  );
  return curve in GAMMAS ? GAMMAS[curve][1](stored) : stored;
}

/* The background's three levels (null: none is seen), the law that they tell, facts. */
function background(levels, width, height, jpeg, scene) {
  const stride = Math.max(1, Math.floor(height / 50));
  const x = [];
  const y = [];
  for (let row = 0; row < height; row += stride) {
    for (let column = 0; column < width; column += stride) {
      x.push(column + 0.5);
      y.push(row + 0.5);
    }
  }
  const seen = cameraHits(scene, scene.camera, x, y, width, height, scene.rayMaxDistance, true).object;
  const sky = [];
  seen.forEach((object, i) => object === BACKGROUND && sky.push(Math.floor(y[i]) * width + Math.floor(x[i])));
  if (!sky.length) return { colour: null, law: "truncated", facts: [] };
  const laws = encoded(scene.background.map((c) => clip(c, 0, 1)));
  const near = { "": 0, fine: 1, coarse: 2 }[jpeg];
  const apart = (a, b) => Math.max(...range(3).map((c) => Math.abs(a[c] - b[c])));
  const fits = [];
  for (const [colour, count] of common(levels, range(width * height))) {
    if (count <= 0.01 * width * height) continue;
    laws.forEach(([, level], i) => {
      if (apart(colour, level) <= near) fits.push({ off: jpeg ? apart(colour, level) : 0, count, i, colour });
    });
  }
  if (fits.length) {
    const { i, colour } = fits.sort((a, b) => a.off - b.off || b.count - a.count || a.i - b.i)[0];
    const law = laws[i][0];
    const [curve] = law.split(",");
    const also = new Set(laws.filter(([, level]) => apart(colour, level) <= near).map(([name]) => name));
    if (curve in GAMMAS) {
      const facts = [{ code: "transfer", text: "transfer", values: { curve } }];
      const both = [...also].filter((name) => name.startsWith(curve));
      return { colour, law: both.length === 1 ? law : curve + EITHER, facts };
    }
    return { colour, law: law === "rounded" && also.has("truncated 256") ? law + EITHER : law, facts: [] };
  }
  const [[colour]] = common(levels, sky);
  const share =
    sky.filter((p) => apart(levels.subarray(4 * p, 4 * p + 3), colour) <= Math.max(near, 0.3)).length /
    sky.length;
  if (share < 0.4) {
    return {
      colour: null,
      law: "truncated",
      facts: [{ code: "background", text: "no_background", values: {} }],
    };
  }
  const mine = { list: colour.map((c) => c / TOP), format: ".2f" };
  const want = { list: scene.background, format: "g" };
  return {
    colour,
    law: "truncated",
    facts: [{ code: "background", text: "background", values: { mine, want } }],
  };
}

/* The 16 most common colours of these pixels, the first most so, and how many have them. */
function common(levels, pixels) {
  const counts = new Map();
  for (const p of pixels) {
    const code = levels[4 * p] * 65536 + levels[4 * p + 1] * 256 + levels[4 * p + 2];
    counts.set(code, (counts.get(code) || 0) + 1);
  }
  const first = [...counts].sort((a, b) => b[1] - a[1] || a[0] - b[0]).slice(0, 16);
  return first.map(([code, count]) => [[code >> 16, (code >> 8) & 255, code & 255], count]);
}

/* Where the background is, given its colour: wide areas of it, so that no shade of a surface that
   happens to be the same is taken for it. mixed: the outline's pixels are mixtures, and the
   background's if more than half of them is. blurred: colours are known to two pixels. */
function flat(levels, width, height, colour, tolerance, mixed, blurred) {
  const n = width * height;
  const distance = new Float64Array(n);
  const darker = new Float64Array(n);
  for (let p = 0; p < n; p++) {
    const off = [0, 1, 2].map((c) => colour[c] - levels[4 * p + c]);
    distance[p] = Math.max(...off.map(Math.abs));
    darker[p] = blurred ? dot(off, LUMA) : Math.max(...off);
  }
  const same = Uint8Array.from(distance, (d) => d <= tolerance);
  const near = same.slice();
  if (mixed) {
    const most = windowed(darker, width, height, 2, 2, MOST);
    const far = windowed(distance, width, height, 2, 2, MOST);
    const plain = 0.5 * Math.max(...colour);
    for (let p = 0; p < n; p++) {
      if (most[p] > plain ? darker[p] < 0.5 * most[p] : distance[p] < 0.5 * far[p]) near[p] = 1;
    }
  }
  const core = dilated(eroded(same, width, height, 2), width, height, 2);
  const grown = dilated(core, width, height, 2, same); // the border, which eroding took away
  for (let y = 0, p = 0; y < height; y++) {
    for (let x = 0; x < width; x++, p++) {
      if (grown[p] && Math.min(x, y, width - 1 - x, height - 1 - y) < 2) core[p] = 1;
    }
  }
  return dilated(core, width, height, 4, near);
}
