/* The lesson's figures: one for each step, each with the one control that shows its idea. */
{
const LESSON = JSON.parse(document.getElementById("lesson-data").textContent);
const FLOOR = -2, MIDDLE = 3; // [m] the floor's height; z of the sphere's and the light's middle
const ABOVE = 12; // [m] the light over the floor
const FLUX = 160; // radiance times area of every light: the lab's 40 times 4 m^2
const POWERS = [1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024];

const scene_like = (name) => structuredClone(LESSON.scenes[name]);
const metres = (v) => unit(v, ".2f", "m");
const shadow_rays = (value, most = 1024) =>
  range("n", () => say("Shadow rays N"), { values: POWERS.filter((n) => n <= most), value });

/* ---- lights ---- */

/* The light of a shape over the middle, `above` the floor, in the scene's keys; side [m]. */
function light_of(shape, above = ABOVE, side = 2) {
  const y = FLOOR + above, white = { color: [1, 1, 1] };
  const triangle = side * Math.SQRT2;
  switch (shape) {
    case "point":
      return { point_lights: [{ name: "point", position: [0, y, MIDDLE], ...white, power: FLUX }] };
    case "quad":
      return { quad_lights: [{ name: "quad", position: [side / 2, y, MIDDLE - side / 2], u: [-side, 0, 0],
        v: [0, 0, side], ...white, power: FLUX / side ** 2 }] };
    case "disk":
      return { disk_lights: [{ name: "disk", center: [0, y, MIDDLE], normal: [0, 1, 0],
        radius: side / Math.sqrt(Math.PI), ...white, power: FLUX / side ** 2 }] };
    case "triangle":
      return { triangle_lights: [{ name: "triangle", position: [triangle / 3, y, MIDDLE - triangle / 3],
        u: [-triangle, 0, 0], v: [0, 0, triangle], ...white, power: FLUX / side ** 2 }] };
    case "sphere": // of the radius, and so the profile, that brings the floor as much
      return { sphere_lights: [{ name: "bulb", center: [0, y, MIDDLE], radius: side / 2, ...white,
        power: FLUX / (Math.PI * (side / 2) ** 2) }] };
  }
  throw new Error(`no light is a ${shape}`);
}

function under(scene, light) {
  for (const kind of Object.keys(scene)) if (kind.endsWith("_lights")) delete scene[kind];
  return Object.assign(scene, light);
}

/* What adds the light in the lab's framework, as penumbra scene --as cpp writes it. */
function cpp_light(scene) {
  const literal = (x) => (Number.isInteger(x) ? `${x}.f` : `${Number(x.toPrecision(9))}f`).replace(/^-0\.f/, "0.f");
  const vector = (v) => `Vec3f( ${v.map(literal).join(", ")} )`;
  const kinds = {
    point_lights: ["PointLight", ["position"]],
    quad_lights: ["QuadLight", ["position", "u", "v"]],
    disk_lights: ["DiskLight", ["center", "normal", "radius"],
      "// center, normal (lit is the other side, as of a quad), radius, color, power"],
    triangle_lights: ["TriangleLight", ["position", "u", "v"],
      "// position, u, v (half a quad: s + t <= 1 in position + s u + t v), color, power"],
    sphere_lights: ["SphereLight", ["center", "radius"],
      "// center, radius, color, power; it is no object: no ray hits it"],
  };
  for (const [kind, [name, keys, comment]] of Object.entries(kinds)) {
    if (!scene[kind]) continue;
    const light = scene[kind][0];
    const given = keys.map((key) => Array.isArray(light[key]) ? vector(light[key]) : literal(light[key]));
    const line = `_addLight( new ${name}( ${given.join(", ")}, WHITE, ${literal(light.power)} ) );`;
    return comment ? [comment, line] : [line];
  }
  throw new Error("a scene without light");
}

/* Where on the floor the umbra and the penumbra end, along the line below the light's middle [m from
   the middle], of a square light `side` wide, `above` the floor: tangents to the sphere, of radius 1
   and 2 m over the floor, from the light's two ends. */
function shadow_ends(side, above) {
  const reach = (from, turned) => {
    const [x, y] = [-from, 2 - above], angle = turned * Math.asin(1 / Math.hypot(x, y));
    const [u, v] = [x * Math.cos(angle) - y * Math.sin(angle), x * Math.sin(angle) + y * Math.cos(angle)];
    return from - (above / v) * u;
  };
  const ends = [side / 2, -side / 2].map((from) => Math.max(reach(from, 1), reach(from, -1)));
  return [Math.min(...ends), Math.max(...ends)];
}

/* Where a point is in the picture, as shares of it. */
function projected({ position, look_at, fov_y_deg }, point, aspect = 1.5) {
  const minus = (a, b) => a.map((v, i) => v - b[i]), dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
  const unit = (a) => a.map((v) => v / Math.hypot(...a));
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const forward = unit(minus(look_at, position)), right = unit(cross([0, 1, 0], forward)), up = cross(forward, right);
  const seen = minus(point, position), half = Math.tan((fov_y_deg * Math.PI) / 360), depth = dot(seen, forward);
  return [0.5 + dot(seen, right) / (2 * depth * half * aspect), 0.5 - dot(seen, up) / (2 * depth * half)];
}

/* ---- zones of the floor ---- */

/* Of each pixel the share of the light that it sees, -1 off the floor; and the light in the floor's
   brightest place. By three exact images: the scene, the scene without its sphere, and the scene lit
   from the camera, where what is not red is no floor. */
async function floor_of(figure, pane) {
  const key = JSON.stringify([pane.scene, figure.sizeAtLast]);
  if (figure.floor?.key === key) return figure.floor;
  const without = { ...pane.scene, spheres: [] };
  const lamp = { name: "lamp", position: pane.scene.camera.position, color: [1, 1, 1], power: 1000 };
  const lit = under(structuredClone(pane.scene), { point_lights: [lamp] });
  const [exact, open, seen] = [await figure.exact({ ...pane, reference: undefined }),
    await figure.exact({ ...pane, scene: without, reference: undefined }),
    await figure.exact({ ...pane, scene: lit, reference: undefined })];
  if (!exact || !open || !seen) return null;
  const pixels = exact.width * exact.height, visible = new Float32Array(pixels);
  let brightest = 0;
  for (let i = 0; i < pixels; i++) {
    const floor = seen.radiance[i] > 0 && seen.radiance[2 * pixels + i] === 0;
    visible[i] = floor ? Math.min(1, exact.radiance[i] / open.radiance[i]) : -1;
    if (floor) brightest = Math.max(brightest, open.radiance[i]);
  }
  figure.floor = { key, exact, open, visible, brightest, width: exact.width, height: exact.height };
  return figure.floor;
}

const ZONES = {
  umbra: (q) => q === 0,
  penumbra: (q) => q > 1e-3 && q < 0.999,
  lit: (q) => q > 0.99999,
};

/* RMSE of the floor's red where `belongs`, as a share of the light in its brightest place; null
   where nothing belongs. */
function zone_noise(frame, floor, belongs, exact = floor.exact) {
  let sum = 0, count = 0;
  floor.visible.forEach((q, i) => {
    if (!belongs(q, i)) return;
    sum += (frame.radiance[i] - exact.radiance[i]) ** 2;
    count++;
  });
  return count ? Math.sqrt(sum / count) / floor.brightest : null;
}

async function measure_zones(figure, [shown]) {
  const floor = await floor_of(figure, shown.pane);
  shown.zones = floor && Object.fromEntries(
    Object.entries(ZONES).map(([name, belongs]) => [name, zone_noise(shown.frame, floor, belongs)]));
}

function zone_text(zones, noise, name) {
  if (noise === null || !zones) return "…";
  return zones[name] === null ? say("there is none") : percent(zones[name]);
}

/* A pixel's error times 4 around grey. */
function error_picture(frame, exact) {
  const pixels = frame.width * frame.height, radiance = new Float32Array(3 * pixels);
  for (let i = 0; i < pixels; i++) {
    let error = 0;
    for (let c = 0; c < 3; c++) error += frame.radiance[c * pixels + i] - exact.radiance[c * pixels + i];
    for (let c = 0; c < 3; c++) radiance[c * pixels + i] = 0.5 + 4 * error;
  }
  return { ...frame, radiance };
}

/* ---- the steps ---- */

const STEPS = {
  "hard-and-soft": () => {
    const scene = ({ side, above, camera }) => {
      const lit = under(scene_like("whole"), light_of(side > 0 ? "quad" : "point", above, side));
      return { ...lit, camera: LESSON.cameras[camera] || lit.camera };
    };
    return {
      controls: [
        range("side", () => say("Side of the light"), { min: 0, max: 8, step: 0.1, value: 2,
          shown: (v) => v > 0 ? unit(v, ".1f", "m") : say("0 m: a point") }),
        range("above", () => say("Height over the floor"), { min: 5, max: 20, step: 0.25, value: ABOVE, shown: metres }),
        choice("method", () => say("Estimate"), [
          ["exact", () => say("without noise")], ["area", () => say("16 shadow rays")]]),
        choice("camera", () => say("Camera"), [
          ["whole", () => say("above the shadow")], ["lab", () => say("the lab’s")],
          ["handout", () => say("the handout’s")]]),
      ],
      panes: (state) => [{ scene: scene(state), reference: null,
        settings: { estimator: state.method, nb_light_samples: 16 } }],
      readouts: ({ side, above }, { frame }) => {
        const [umbra, penumbra] = shadow_ends(side, above);
        return [
          [say("Umbra ends at"), umbra > 0 ? metres(umbra) : say("there is none")],
          [say("Penumbra ends at"), metres(penumbra)],
          [say("Penumbra’s width"), metres(penumbra - umbra)],
          [say("Time"), unit(frame.milliseconds, ".1f", "ms")],
        ];
      },
      cpp: (state) => cpp_light(scene(state)),
    };
  },

  "one-ray": () => {
    const sketch = new RaySketch();
    const scene = ({ mode, s }) => {
      const whole = scene_like("whole"), light = whole.quad_lights[0], small = 0.02;
      if (mode === "one") {
        // A light so small that every sample is the same place, as bright as the whole one.
        light.position = [1 - 2 * s + small / 2, 10, MIDDLE - small / 2];
        [light.u, light.v] = [[-small, 0, 0], [0, 0, small]];
        light.power = FLUX / small ** 2;
      }
      return whole;
    };
    return {
      aside: sketch.element,
      controls: [
        range("x", () => say("Place of x on the floor"), { min: -3, max: 3, step: 0.05, value: 1.2, shown: metres }),
        range("s", () => say("Random number s"), { min: 0, max: 1, step: 0.01, value: 0.8, shown: (v) => number(v, ".2f") }),
        choice("mode", () => say("In the picture"), [
          ["one", () => say("all pixels use this s")], ["each", () => say("each draws its own")]]),
        button(() => say("Draw s"), (figure) => figure.set("s", Math.round(100 * Math.random()) / 100)),
      ],
      panes: (state) => [{ scene: scene(state), settings: { nb_light_samples: 1 }, reference: null }],
      changed: (state) => sketch.draw(state),
      marked: ({ x }) => projected(LESSON.scenes.whole.camera, [x, FLOOR, MIDDLE]),
      readouts: (state) => sample_steps(state).map(({ term, value }) => [term, value]),
    };
  },

  "average": () => ({
    controls: [shadow_rays(4), new_numbers()],
    panes: ({ n }, figure) => [{ scene: scene_like("close"), settings: { nb_light_samples: n, seed: figure.seed || 0 } }],
    readouts: (state, shown) => [
      ...usualReadouts(state, shown),
      [say("Mean of the picture"), number(mean_of(shown.frame), ".3f")],
    ],
    again: (figure) => { figure.seed = 0; },
  }),

  "umbra": () => ({
    controls: [
      shadow_rays(16, 256),
      choice("view", () => say("Show"), [["picture", () => say("picture")], ["error", () => say("error × 4")]]),
    ],
    panes: ({ n, view }) => [{
      scene: scene_like("close"), settings: { nb_light_samples: n },
      ...(view === "error" && { show: (frame, exact) => (exact ? error_picture(frame, exact) : frame) }),
    }],
    rested: measure_zones,
    readouts: (state, { frame, zones, noise }) => [
      [say("Noise in the umbra"), zone_text(zones, noise, "umbra")],
      [say("in the penumbra"), zone_text(zones, noise, "penumbra")],
      [say("in the light"), zone_text(zones, noise, "lit")],
      [say("Time"), unit(frame.milliseconds, ".1f", "ms")],
    ],
  }),

  "square-root": () => new Accumulation().description(),

  "antialiasing": () => {
    const pane = (n, m, label) => ({
      scene: scene_like("whole"), size: [150, 100], label, settings: { nb_light_samples: n, samples_per_pixel: m },
      reference: m > 1 ? { scene: scene_like("whole"), settings: { samples_per_pixel: 256 } } : undefined,
    });
    return {
      controls: [
        shadow_rays(4, 64),
        range("m", () => say("Camera rays M"), { values: [1, 4, 9, 16, 64], value: 16 }),
      ],
      panes: ({ n, m }) => [
        pane(n * m, 1, () => say("Without: {rays:,d} shadow rays a pixel", { rays: n * m })),
        pane(n, m, () => say("With: {m} × {n} shadow rays a pixel", { m, n })),
      ],
      rested: async (figure, shown) => {
        const floor = await floor_of(figure, shown[0].pane);
        if (!floor) return;
        // Away from outlines: where the pixel and its neighbours are floor, and in the penumbra.
        const inside = (q, i) => [0, -1, 1, -floor.width, floor.width].every((step) => {
          const near = floor.visible[i + step];
          return near > 0.02 && near < 0.98;
        });
        for (const each of shown) each.zone = zone_noise(each.frame, floor, inside, each.exact);
      },
      readouts: (state, { frame, noise, zone }) => [
        [say("Noise in the penumbra"), noise === null || zone === undefined ? "…" : zone === null ? say("there is none") : percent(zone)],
        [say("Time"), unit(frame.milliseconds, ".1f", "ms")],
        [say("Shadow rays"), number(frame.shadow_rays, ",d")],
      ],
    };
  },

  "trade": () => new Trade().description(),

  "floats": () => {
    const distances = [0, ...Array.from({ length: 9 }, (_, i) => 10 ** i)];
    const sizes = Array.from({ length: 13 }, (_, i) => i - 6);
    const settings = ({ method }) => (method === "exact" ? { estimator: "exact" }
      : { estimator: "area", sampler: "sobol", nb_light_samples: 64 });
    return {
      controls: [
        range("far", () => say("Moved along x by"), { values: distances, value: 0, shown: (v) => unit(v, ",", "m") }),
        range("power", () => say("Scaled by"), { values: sizes, value: 0,
          shown: (v) => (v === 0 ? "1" : `10${superscript(v)}`) }),
        choice("method", () => say("Estimate"), [
          ["area", () => say("64 shadow rays")], ["exact", () => say("closed form")]]),
        choice("view", () => say("Show"), [["picture", () => say("picture")], ["error", () => say("error × 4")]]),
      ],
      panes: (state) => [{
        scene: moved(scene_like("close"), 10 ** state.power, state.far), settings: settings(state),
        reference: { scene: scene_like("close"), settings: settings(state) },
        ...(state.view === "error" && { show: (frame, exact) => (exact ? error_picture(frame, exact) : frame) }),
      }],
      readouts: ({ far, power }, { frame, noise }) => [
        [say("Error by rounding"), noise === null ? "…" : percent(noise)],
        [say("Scene’s size"), `${scale(10 * 10 ** power)}${NO_BREAK}m`],
        [say("Between neighbouring floats"), `${scale(spacing(far + 10 ** power))}${NO_BREAK}m`],
        [say("Time"), unit(frame.milliseconds, ".1f", "ms")],
      ],
    };
  },

  "other-lights": () => {
    const scene = ({ shape, above, side }) => under(scene_like("close"), light_of(shape, above, side));
    return {
      controls: [
        choice("shape", () => say("Light"), [
          ["quad", () => say("quad")], ["disk", () => say("disk")],
          ["triangle", () => say("triangle")], ["sphere", () => say("sphere")]], "disk"),
        choice("estimator", () => say("Samples spread over"), [
          ["area", () => say("the area")], ["solid-angle", () => say("the solid angle")]]),
        shadow_rays(16, 256),
        range("above", () => say("Height over the floor"), { min: 5, max: 16, step: 0.25, value: ABOVE, shown: metres }),
        range("side", () => say("Side of the light"), { min: 1, max: 6, step: 0.25, value: 2, shown: metres }),
      ],
      panes: (state) => [{ scene: scene(state), size: [300, 200],
        settings: { nb_light_samples: state.n, estimator: state.estimator } }],
      rested: measure_zones,
      readouts: (state, { frame, zones, noise }) => [
        [say("Noise in the penumbra"), zone_text(zones, noise, "penumbra")],
        [say("in the light"), zone_text(zones, noise, "lit")],
        [say("Time"), unit(frame.milliseconds, ".1f", "ms")],
      ],
      cpp: (state) => cpp_light(scene(state)),
    };
  },
};

function new_numbers() {
  return button(() => say("Other random numbers"), (figure) => {
    figure.seed = (figure.seed || 0) + 1;
    figure.invalidate();
  });
}

function mean_of({ radiance }) {
  return radiance.reduce((sum, value) => sum + value, 0) / radiance.length;
}

/* The distance from a float32 to the next one [the value's unit]. */
function spacing(value) {
  return 2 ** (Math.floor(Math.log2(Math.max(value, 2 ** -126))) - 23);
}

/* The scene with every length times `scale`, and then along x by `far` [m], its camera too. */
function moved(scene, scale, far) {
  const place = (v) => [v[0] * scale + far, v[1] * scale, v[2] * scale], length = (v) => v.map((x) => x * scale);
  scene.camera.position = place(scene.camera.position);
  scene.camera.look_at = place(scene.camera.look_at);
  scene.ray_max_distance *= scale;
  for (const sphere of scene.spheres) Object.assign(sphere, { center: place(sphere.center), radius: sphere.radius * scale });
  for (const plane of scene.planes) plane.point = place(plane.point);
  for (const light of scene.quad_lights) {
    Object.assign(light, { position: place(light.position), u: length(light.u), v: length(light.v) });
  }
  return scene;
}

/* ---- one shadow ray ---- */

/* The handout's steps (a) to (d) and the integrator's, for t = 1/2 and the floor's red. */
function sample_of({ x, s }) {
  const y = [1 - 2 * s, FLOOR + ABOVE, MIDDLE], w = [y[0] - x, ABOVE, 0];
  const d = Math.hypot(...w), direction = w.map((v) => v / d), cosine = ABOVE / d; // both normals are vertical
  const pdf = (d * d) / (4 * cosine);
  // The sphere, of radius 1, is 2 m over the floor: its middle's distance from the ray.
  const along = -x * direction[0] + 2 * direction[1];
  const free = Math.hypot(-x - along * direction[0], 2 - along * direction[1]) >= 1;
  return { x, y, d, direction, cosine, pdf, arriving: 40 / pdf, free, radiance: free ? (40 / pdf) * cosine : 0 };
}

function sample_steps(state) {
  const { y, d, direction, cosine, pdf, arriving, free, radiance } = sample_of(state);
  const vector = (v) => `(${v.map((c) => number(c, ".2f").replace("-", "−")).join(language() === "fr" ? " ; " : ", ")})`;
  return [
    { term: say("(a) position y"), value: vector(y) },
    { term: say("(b) direction"), value: vector(direction) },
    { term: say("(b) distance d"), value: metres(d) },
    { term: say("cos θ, at both ends"), value: number(cosine, ".3f") },
    { term: say("(c) _pdf"), value: number(pdf, ".2f") },
    { term: say("(d) _radiance"), value: number(arriving, ".3f") },
    { term: say("visibility V"), value: free ? say("1: free") : say("0: hidden") },
    { term: say("L, red"), value: number(radiance, ".3f") },
  ];
}

/* The plane through the middle of sphere and light: x, y and the ray between them. */
class RaySketch {
  constructor() {
    this.svg = drawn("svg", { viewBox: "-3.9 -10.9 7.8 14.1", role: "img", class: "sketch" });
    this.element = element("div", { class: "aside" });
    this.element.append(this.svg);
  }

  draw(state) {
    const { svg } = this, { x, y, free, direction, d } = sample_of(state), [umbra, penumbra] = shadow_ends(2, ABOVE);
    const line = (x1, y1, x2, y2, name) => svg.append(drawn("line", { x1, y1: -y1, x2, y2: -y2, class: name }));
    const label = (at_x, at_y, text, name = "") => svg.append(drawn("text", { x: at_x, y: -at_y, class: name }, text));
    svg.replaceChildren();
    svg.setAttribute("aria-label", free
      ? say("A drawing: the floor, the sphere and the light seen from the side. The ray from x to y is free.")
      : say("A drawing: the floor, the sphere and the light seen from the side. The sphere hides y from x."));
    for (const [from, to, name] of [[-3.9, -penumbra, "zone-lit"], [-penumbra, -umbra, "zone-penumbra"],
      [-umbra, umbra, "zone-umbra"], [umbra, penumbra, "zone-penumbra"], [penumbra, 3.9, "zone-lit"]]) {
      svg.append(drawn("rect", { x: from, y: 2, width: to - from, height: 0.3, class: name }));
    }
    label(0, -2.75, say("umbra"), "zone middle");
    label(-2.75, -2.75, say("lit"), "zone middle");
    label(2.75, -2.75, say("lit"), "zone middle");
    line(-3.9, FLOOR, 3.9, FLOOR, "ground");
    svg.append(drawn("circle", { cx: 0, cy: 0, r: 1, class: "ball" }));
    line(-1, y[1], 1, y[1], "lamp");
    label(1.25, y[1] - 0.15, say("light"), "zone");
    // A hidden ray ends where it meets the sphere; beyond, it is dotted.
    const hit = free ? d : entry(x, direction);
    line(x, FLOOR, x + hit * direction[0], FLOOR + hit * direction[1], free ? "ray free" : "ray blocked");
    if (!free) {
      line(x + hit * direction[0], FLOOR + hit * direction[1], y[0], y[1], "ray beyond");
      const [u, v] = [x + hit * direction[0], -(FLOOR + hit * direction[1])];
      svg.append(drawn("path", { d: `M${u - 0.2} ${v - 0.2}l.4 .4m0 -.4l-.4 .4`, class: "cross" }));
    }
    line(x, FLOOR, x, FLOOR + 1.3, "normal");
    line(y[0], y[1], y[0], y[1] - 1.3, "normal");
    svg.append(drawn("circle", { cx: x, cy: 2, r: 0.13, class: "dot" }), drawn("circle", { cx: y[0], cy: -y[1], r: 0.13, class: "dot" }));
    label(x + (x < 0 ? -0.25 : 0.25), FLOOR + 0.25, "x", x < 0 ? "variable end" : "variable");
    label(y[0], y[1] + 0.3, "y", "variable middle");
    label(x + (direction[0] * d) / 3 + 0.25, FLOOR + (direction[1] * d) / 3, "d", "variable");
  }
}

/* Where the ray from the floor meets the sphere [m along it]. */
function entry(x, direction) {
  const along = -x * direction[0] + 2 * direction[1], off = x * x + 4 - along * along;
  return along - Math.sqrt(Math.max(0, 1 - off));
}

/* ---- the square root of N ---- */

/* Frames of independent numbers, averaged; the error of their mean against how many samples it has. */
class Accumulation {
  static MOST = 4096;
  static PACE = 140; // [ms] between two points, so that one sees the plot grow
  static SIZE = [300, 200];
  static PILOTS = 4; // frames of N = 256 of which the law's sigma is estimated

  constructor() {
    this.seed = 1;
    this.element = element("div", { class: "aside plot" });
    this.svg = drawn("svg", { role: "img", class: "chart" });
    this.element.append(this.svg);
    this.plot = new LogPlot(this.svg, { x: [0, 4], y: [-3, 0],
      xLabel: () => say("Shadow rays N"), yLabel: () => say("relative error") });
    this.restart();
  }

  restart() {
    clearTimeout(this.timer);
    Object.assign(this, { total: 0, mean: null, playing: false, points: { picture: [], pixel: [] } });
  }

  description() {
    return {
      aside: this.element,
      controls: [
        { ...choice("over", () => say("Error of"), [
          ["picture", () => say("the whole picture")], ["pixel", () => say("one pixel")]]), renders: false },
        button(() => this.label(), (figure) => this.press(figure)),
        button(() => say("Start again"), (figure) => {
          this.seed += 2 * Accumulation.MOST;
          this.restart();
          figure.refresh();
          figure.invalidate();
        }),
      ],
      panes: () => {
        // Points lie evenly on the logarithmic axis.
        const n = Math.max(1, Math.min(Math.floor(this.total / 2), Accumulation.MOST - this.total));
        const { points } = this; // of a run that may have ended when the frame is there
        return [{
          ...this.pane(), settings: { nb_light_samples: n, seed: this.seed + this.total },
          show: (frame) => (points === this.points ? this.shown(frame, n) : frame),
        }];
      },
      rested: async (figure) => {
        await this.expect(figure);
        figure.refresh();
      },
      changed: ({ over }) => this.draw(over),
      marked: ({ over }) => over === "pixel" && this.law
        ? [this.law.pixel.at % 300, Math.floor(this.law.pixel.at / 300)].map(
          (v, i) => (v + 0.5) / Accumulation.SIZE[i]) : null,
      readouts: ({ over }) => {
        const points = this.points[over], last = points.at(-1);
        return [
          [say("Shadow rays N"), number(this.total, ",d")],
          [say("Error"), last ? percent(last[1]) : "…"],
          [say("Slope, fitted"), points.length > 4 ? number(slope_of(points), ".2f").replace("-", "−") : "…"],
        ];
      },
      again: () => {
        this.seed = 1;
        this.restart();
      },
      described: () => say("The mean of all frames so far"),
    };
  }

  pane() {
    return { scene: scene_like("close"), size: Accumulation.SIZE, reference: null };
  }

  label() {
    if (this.total >= Accumulation.MOST) return say("All are there");
    if (REDUCED_MOTION.matches) return say("Half as many again");
    return this.playing ? say("Pause") : say("Accumulate");
  }

  async press(figure) {
    if (this.total >= Accumulation.MOST) return;
    await this.expect(figure);
    clearTimeout(this.timer);
    if (!REDUCED_MOTION.matches) this.playing = !this.playing;
    if (this.playing || REDUCED_MOTION.matches) figure.invalidate();
    figure.refresh();
  }

  /* The mean, this frame of n samples in it; painted twice, a frame counts once. */
  shown(frame, n) {
    if (frame === this.last) return this.mean;
    this.last = frame;
    const before = this.total, now = this.total += n;
    const radiance = frame.radiance.map(
      (value, i) => (before * (this.mean?.radiance[i] ?? 0) + n * value) / now);
    this.mean = { ...frame, radiance };
    this.measure();
    return this.mean;
  }

  measure() {
    if (!this.law) return;
    const { exact, pixel } = this.law;
    this.points.picture.push([this.total, relativeError(this.mean, exact)]);
    this.points.pixel.push([this.total, Math.abs(this.mean.radiance[pixel.at] - exact.radiance[pixel.at]) * pixel.weight]);
    if (this.total >= Accumulation.MOST) this.playing = false;
    if (this.playing) this.timer = setTimeout(() => this.figure.invalidate(), Accumulation.PACE);
    this.figure.refresh();
  }

  /* What is to be expected: for the picture and for one pixel the error sigma / sqrt(N), and the
     degrees of freedom of its square (Satterthwaite's), of which the band follows. */
  async expect(figure) {
    if (this.law) return;
    this.figure = figure;
    const pane = { ...this.pane(), reference: undefined }, N = 256;
    const exact = await figure.exact(pane), open = await figure.exact({ ...pane, scene: { ...pane.scene, spheres: [] } });
    const squares = new Float64Array(exact.radiance.length);
    for (let k = 0; k < Accumulation.PILOTS; k++) {
      const [width, height] = Accumulation.SIZE;
      const frame = await figure.core.render(pane.scene, { width, height, nb_light_samples: N, seed: 1e9 + k });
      frame.radiance.forEach((value, i) => {
        squares[i] += (N / Accumulation.PILOTS) * (value - exact.radiance[i]) ** 2;
      });
    }
    if (this.law) return;
    // As relativeError weighs them; a variance from four squares overstates its own square by 1 + 2/4.
    let sum = 0, sumOfSquares = 0, count = 0, at = 0, nearest = 1;
    const pixels = exact.width * exact.height;
    squares.forEach((variance, i) => {
      const right = exact.radiance[i];
      if (right <= 0) return;
      count++;
      sum += variance / (right ** 2 + 0.01);
      sumOfSquares += (variance / (right ** 2 + 0.01)) ** 2 / (1 + 2 / Accumulation.PILOTS);
      const half = i < pixels ? Math.abs(right / open.radiance[i] - 0.5) : 1;
      if (half < nearest) [at, nearest] = [i, half];
    });
    // The pixel that sees just half of the light: q (1 - q) = 1/4.
    const weight = 1 / Math.sqrt(exact.radiance[at] ** 2 + 0.01);
    this.law = {
      exact,
      picture: { sigma: Math.sqrt(sum / count), freedom: sum ** 2 / sumOfSquares },
      pixel: { sigma: 0.5 * open.radiance[at] * weight, freedom: 1, at, weight },
    };
    this.measure();
  }

  draw(over) {
    const points = this.points[over], series = [];
    if (this.law) {
      const { sigma, freedom } = this.law[over], [low, high] = band(freedom), ends = [1, 10000];
      series.push(
        { kind: "area", name: "band", points: [...ends.map((n) => [n, (high * sigma) / Math.sqrt(n)]),
          ...ends.reverse().map((n) => [n, (low * sigma) / Math.sqrt(n)])] },
        { kind: "line", name: "law", points: [1, 10000].map((n) => [n, sigma / Math.sqrt(n)]) });
    }
    series.push({ kind: "line", name: "s0", points }, { kind: "marks", name: "s0", points, mark: 0 });
    this.plot.draw(series);
    const last = points.at(-1);
    this.svg.setAttribute("aria-label", last
      ? say("A plot of the error against N, on logarithmic axes: {count} points beside a line of slope −1/2. At N = {n:,d} the error is {error}.",
        { count: points.length, n: last[0], error: percent(last[1]) })
      : say("A plot of the error against N, on logarithmic axes: still empty."));
  }
}

/* Where the root of chi-squared over its degrees of freedom is in 95 of 100 cases: Wilson and
   Hilferty's cube root, and for one degree, where that is poor, the normal's own quantiles. */
function band(freedom) {
  if (freedom < 2) return [0.0313, 2.2414];
  const root = (z) => (1 - 2 / (9 * freedom) + z * Math.sqrt(2 / (9 * freedom))) ** 1.5;
  return [root(-1.96), root(1.96)];
}

function slope_of(points) {
  const logs = points.filter(([, error]) => error > 0).map(([n, error]) => [Math.log(n), Math.log(error)]);
  const mean = (i) => logs.reduce((sum, p) => sum + p[i], 0) / logs.length, [x, y] = [mean(0), mean(1)];
  return logs.reduce((sum, p) => sum + (p[0] - x) * (p[1] - y), 0) / logs.reduce((sum, p) => sum + (p[0] - x) ** 2, 0);
}

/* ---- what a millisecond buys ---- */

const METHODS = {
  independent: { label: () => say("independent"), settings: {} },
  stratified: { label: () => say("stratified"), settings: { sampler: "stratified" } },
  sobol: { label: () => say("Sobol"), settings: { sampler: "sobol" } },
  directions: { label: () => say("Sobol, by solid angle"), settings: { sampler: "sobol", estimator: "solid-angle" } },
  exact: { label: () => say("exact"), settings: { estimator: "exact" } },
};

/* Error against time of each method on this machine. */
class Trade {
  static COUNTS = [1, 4, 16, 64, 256];
  static TIMES = 5; // frames, of which the fastest counts: others shared the machine

  constructor() {
    this.points = {};
    this.element = element("div", { class: "aside plot" });
    this.svg = drawn("svg", { role: "img", class: "chart" });
    this.legend = element("ul", { class: "legend" });
    this.said = element("p", { class: "said", role: "status" });
    this.table = element("div", { class: "measured" });
    this.element.append(this.svg, this.legend, this.said, this.table);
    this.plot = new LogPlot(this.svg, { x: [-1, 3], y: [-4, 0],
      xLabel: () => say("time of a frame [ms]"), yLabel: () => say("relative error") });
  }

  description() {
    const options = Object.entries(METHODS).map(([name, { label }]) => [name, label]);
    return {
      aside: this.element,
      controls: [
        choice("method", () => say("Method"), options, "independent"),
        shadow_rays(16, 256),
        button(() => (this.running ? say("Stop") : say("Measure on this machine")), (figure) => this.press(figure)),
      ],
      panes: ({ method, n }) => [{ scene: scene_like("close"), settings: { nb_light_samples: n, ...METHODS[method].settings } }],
      changed: (state) => this.draw(state),
      again: () => {
        this.running = false;
        this.points = {};
      },
    };
  }

  async press(figure) {
    this.running = !this.running;
    figure.refresh();
    if (!this.running) return;
    this.points = {};
    const pane = { scene: scene_like("close"), settings: {} }, exact = await figure.exact(pane);
    for (const [name, { settings }] of Object.entries(METHODS)) {
      this.points[name] = [];
      for (const n of name === "exact" ? [1] : Trade.COUNTS) {
        const asked = { width: exact.width, height: exact.height, nb_light_samples: n, ...settings };
        const frames = [];
        for (let k = 0; k < Trade.TIMES && this.running; k++) {
          frames.push(await figure.core.render(pane.scene, { ...asked, seed: k }));
        }
        if (!this.running) break;
        const fastest = Math.min(...frames.map((frame) => frame.milliseconds));
        const errors = frames.map((frame) => relativeError(frame, exact) ** 2);
        const error = Math.sqrt(errors.reduce((sum, e) => sum + e, 0) / errors.length);
        // Timers of browsers are coarse: what they call no time took less than a tenth of a millisecond.
        this.points[name].push({ n, ms: Math.max(0.1, fastest), error });
        figure.refresh();
      }
    }
    this.running = false;
    figure.refresh();
    figure.figure.dataset.measured = "yes";
  }

  draw() {
    const names = Object.keys(METHODS).filter((name) => this.points[name]?.length);
    this.plot.draw(names.flatMap((name) => {
      const index = Object.keys(METHODS).indexOf(name);
      const points = this.points[name].map(({ ms, error }) => [ms, error]);
      if (name === "exact") {
        const [[ms]] = points;
        return [{ kind: "line", name: `s${index}`, points: [[ms, 1], [ms, 1e-4]] }];
      }
      return [{ kind: "line", name: `s${index}`, points }, { kind: "marks", name: `s${index}`, mark: index, points }];
    }));
    this.legend.replaceChildren(...names.map((name) => this.entry(name)));
    this.svg.setAttribute("aria-label", names.length
      ? say("A plot of the error against the time of a frame, on logarithmic axes. The table below it holds its numbers.")
      : say("A plot of the error against the time of a frame: still empty. The button measures it."));
    this.said.textContent = this.verdict();
    this.writeTable(names);
  }

  entry(name) {
    const index = Object.keys(METHODS).indexOf(name), item = element("li", {});
    const mark = drawn("svg", { viewBox: "-8 -8 16 16", "aria-hidden": "true", class: "key" });
    mark.append(name === "exact" ? drawn("path", { d: "M0 -8V8", class: `line s${index}` })
      : drawn("path", { d: MARKS[index], class: `mark s${index}` }));
    item.append(mark, METHODS[name].label());
    return item;
  }

  verdict() {
    const all = Object.entries(this.points).flatMap(([name, points]) => points.map((point) => ({ name, ...point })));
    if (this.running || !all.length) return "";
    const called = ({ name, n }) => (name === "exact" ? METHODS[name].label() : say("{method}, N = {n}", { method: METHODS[name].label(), n }));
    const least = (list, key) => list.reduce((best, point) => (best && best[key] <= point[key] ? best : point), null);
    const within = least(all.filter(({ ms }) => ms <= 5), "error"), reaching = least(all.filter(({ error }) => error <= 1e-3), "ms");
    return [
      within && say("In 5 ms on this machine: {method}, with an error of {error}.",
        { method: called(within), error: within.name === "exact" ? "0" : percent(within.error) }),
      reaching && say("For an error of 1 in 1000: {method}, in {ms:.1f} ms.", { method: called(reaching), ms: reaching.ms }),
    ].filter(Boolean).join(" ");
  }

  writeTable(names) {
    if (!names.length) return this.table.replaceChildren();
    const open = this.table.querySelector("details")?.open;
    const details = element("details", open ? { open: "" } : {}), summary = element("summary", {});
    const table = element("table", {}), head = element("tr", {}), body = element("tbody", {});
    summary.textContent = say("As a table");
    for (const text of [say("Method"), "N", say("Time"), say("Error")]) {
      const cell = element("th", { scope: "col" });
      cell.textContent = text;
      head.append(cell);
    }
    for (const name of names) {
      for (const { n, ms, error } of this.points[name]) {
        const row = element("tr", {}), first = element("th", { scope: "row" });
        first.textContent = METHODS[name].label();
        row.append(first, ...[name === "exact" ? "–" : String(n), unit(ms, ".1f", "ms"),
          name === "exact" ? "0" : percent(error)].map((text) => {
          const cell = element("td", {});
          cell.textContent = text;
          return cell;
        }));
        body.append(row);
      }
    }
    const top = element("thead", {});
    top.append(head);
    table.append(top, body);
    details.append(summary, table);
    this.table.replaceChildren(details);
  }
}

for (const [anchor, step] of Object.entries(STEPS)) {
  new LiveFigure(document.getElementById(`figure-${anchor}`), step());
}

for (const code of document.querySelectorAll(".cpp code")) {
  const copy = element("button", { type: "button" });
  spoken(copy, () => say("Copy"));
  copy.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(code.textContent);
      copy.textContent = say("Copied");
    } catch { // not from where the page is: then it is selected, for Ctrl+C
      getSelection().selectAllChildren(code);
      copy.textContent = say("Selected: press Ctrl+C");
    }
    setTimeout(() => { copy.textContent = say("Copy"); }, 2500);
  });
  code.closest("details").append(copy);
}
}
