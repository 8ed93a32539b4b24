"use strict";
/* A worker of core.js: some rows of a picture, or some of many receivers, by the C code in
 * WebAssembly. One message in, one out: the result, or { error }. */

/* What a scene file holds, in the order in which C's reader takes it: each kind of item, the
 * function of c_renderer/wasm/scene.c that takes one, and which of its keys. */
const ITEMS = [
  ["spheres", "scene_sphere", ["center", "radius", "color"]],
  ["planes", "scene_plane", ["point", "normal", "color"]],
  ["point_lights", "scene_point_light", ["position", "color", "power"]],
  ["quad_lights", "scene_quad_light", ["position", "u", "v", "color", "power"]],
  ["disk_lights", "scene_disk_light", ["center", "normal", "radius", "color", "power"]],
  ["triangle_lights", "scene_triangle_light", ["position", "u", "v", "color", "power"]],
  ["sphere_lights", "scene_sphere_light", ["center", "radius", "color", "power"]],
];
const SINGLE = ["radius", "power", "fov_y_deg", "ray_max_distance"];
const POSITIVE = ["radius", "fov_y_deg", "ray_max_distance"];
/* In the order of C's enums. The command line calls "stratified" "jittered". */
const SAMPLERS = { independent: 0, stratified: 1, jittered: 1, sobol: 2 };
const ESTIMATORS = { area: 0, textbook: 1, "solid-angle": 2, exact: 3 };
const MODULES = ["domain", "visibility", "weight", "scale", "lights", "average", "clamp",
  "output", "colour", "generator"];

const modules = {}, instances = {};

onmessage = ({ data: asked }) => {
  try {
    if (asked.module) modules[asked.name] = asked.module;
    const wasm = (instances[asked.name] ??= new WebAssembly.Instance(modules[asked.name]).exports);
    const { result, transfer } = CALLS[asked.call](wasm, asked);
    postMessage(result, transfer);
  } catch (error) {
    delete instances[asked.name]; // after a trap its memory may hold anything
    const what = error instanceof RangeError ? "out of memory: " : "";
    postMessage({ error: what + error.message });
  }
};

const CALLS = {
  ready: () => ({ result: {}, transfer: [] }),

  render(wasm, { scene, settings, first, step }) {
    const { width, height } = settings;
    set_scene(wasm, scene);
    const start = performance.now();
    const planes = in_memory(wasm.core_rows(
      ...picture(settings), one_of(SAMPLERS, settings, "sampler"),
      one_of(ESTIMATORS, settings, "estimator"), first, step));
    const milliseconds = performance.now() - start;
    const radiance = new Float32Array(wasm.memory.buffer, planes, 3 * width * height);
    return rows_of(wasm, scene, settings, first, step, milliseconds, (out, c, y) => {
      const at = (c * height + y) * width;
      out.set(radiance.subarray(at, at + width));
    });
  },

  mistaken(wasm, { scene, settings, choices, first, step }) {
    const { width, height, position_x, position_y, divisor } = settings;
    check(settings, "nb_light_samples", 1, 4095);
    check(settings, "divisor", 0, 1);
    for (const name of Object.keys(choices)) {
      if (!MODULES.includes(name)) throw new Error(`${name}: not a module of the catalogue`);
    }
    set_scene(wasm, scene);
    const heap = new Heap(wasm);
    const chosen = heap.put(
      Int32Array.from(MODULES, (name) => heap.choice(name, choices[name] ?? "std")));
    const wraps = Boolean(wasm.saved_wrapped(chosen));
    const start = performance.now();
    const pixels = in_memory(wasm.mistaken_rows(
      chosen, ...picture(settings), position_x, position_y, divisor, first, step));
    const milliseconds = performance.now() - start;
    heap.free();
    const rgb = new Float32Array(wasm.memory.buffer, pixels, 3 * width * height);
    const made = rows_of(wasm, scene, settings, first, step, milliseconds, (out, c, y) => {
      for (let x = 0; x < width; x++) out[x] = rgb[3 * (y * width + x) + c];
    });
    made.result.wraps = wraps;
    return made;
  },

  moments(wasm, { scene, light, receivers, before, domain, rays, weights, grid }) {
    const n = receivers.object.length;
    set_scene(wasm, scene);
    check({ light }, "light", 0, wasm.scene_lights() - 1);
    check({ grid }, "grid", 1, 24);
    const heap = new Heap(wasm);
    const made = [rays.length, rays.length * weights.length, rays.length * weights.length]
      .map((count) => ({ place: heap.take(4 * count * n), count: count * n }));
    wasm.moments(
      light, n, before,
      ...["point", "normal", "right", "down", "object"].map((key) => heap.put(receivers[key])),
      heap.choice("domain", domain),
      heap.put(Int32Array.from(rays, (name) => heap.choice("visibility", name))), rays.length,
      heap.put(Int32Array.from(weights, (name) => heap.choice("weight", name))), weights.length,
      grid, ...made.map(({ place }) => place));
    const [chance, first, second] = made.map(({ place, count }) =>
      new Float32Array(wasm.memory.buffer, place, count).slice());
    heap.free();
    const result = { chance, first, second };
    return { result, transfer: Object.values(result).map(({ buffer }) => buffer) };
  },
};

/* The rows first, first + step, ... of three planes, one after the other, each filled by `fill`. */
function rows_of(wasm, scene, settings, first, step, milliseconds, fill) {
  const { width, height } = settings;
  const count = Math.max(0, Math.ceil((height - first) / step));
  const rows = new Float32Array(3 * count * width);
  for (let c = 0; c < 3; c++) {
    for (let k = 0; k < count; k++) {
      const at = (c * count + k) * width;
      fill(rows.subarray(at, at + width), c, first + k * step);
    }
  }
  const shadow_rays = settings.estimator === "exact" ? 0 :
    surface_pixels(wasm, scene, width, height, first, step) *
      wasm.scene_shadow_rays(settings.nb_light_samples) * settings.samples_per_pixel;
  return { result: { rows, first, step, milliseconds, shadow_rays }, transfer: [rows.buffer] };
}

/* In how many of these pixels the ray through the centre meets a surface; remembered, since a
 * light that moves does not change it, and a worker gets now these rows and now the others. */
const counted = new Map();
function surface_pixels(wasm, scene, ...where) {
  const { camera, spheres, planes, ray_max_distance } = scene;
  const of = JSON.stringify([camera, spheres, planes, ray_max_distance, where]);
  if (!counted.has(of)) {
    if (counted.size >= 64) counted.clear();
    counted.set(of, wasm.scene_surface_pixels(...where));
  }
  return counted.get(of);
}

/* ---- a scene file's numbers, checked ---- */

function set_scene(wasm, scene) {
  const { camera } = scene;
  const done = (where, refusal) => {
    if (refusal) throw new Error(`${where}: ${text_at(wasm, refusal)}`);
  };
  done("camera", wasm.scene_begin(
    ...numbers(camera, ["position", "look_at", "up", "fov_y_deg"], "camera"),
    ...numbers(scene, ["background", "ray_max_distance"], "scene")));
  for (const [kind, add, keys] of ITEMS) {
    (scene[kind] ?? []).forEach((item, i) => {
      done(`${kind}[${i}]`, wasm[add](...numbers(item, keys, `${kind}[${i}]`)));
    });
  }
}

function numbers(item, keys, where) {
  return keys.flatMap((key) => {
    const single = SINGLE.includes(key), value = single ? [item?.[key]] : item?.[key];
    const whole = Array.isArray(value) && value.length === (single ? 1 : 3);
    if (!whole || !value.every(Number.isFinite)) {
      throw new Error(`${where}.${key}: not ${single ? "a number" : "three numbers"}`);
    }
    if (POSITIVE.includes(key) && !(value[0] > 0)) throw new Error(`${where}.${key}: not above 0`);
    return value;
  });
}

function check(settings, key, least, most) {
  const value = settings[key];
  if (!Number.isInteger(value) || value < least || value > most) {
    throw new Error(`${key}: ${value} is not a whole number from ${least} to ${most}`);
  }
  return value;
}

function one_of(names, settings, key) {
  if (!Object.hasOwn(names, settings[key])) throw new Error(`${key}: no ${settings[key]}`);
  return names[settings[key]];
}

/* What both renderers take first. */
function picture(settings) {
  return [
    check(settings, "width", 1, 16384), check(settings, "height", 1, 16384),
    check(settings, "nb_light_samples", 1, 1 << 20),
    check(settings, "samples_per_pixel", 1, 1 << 16),
    check(settings, "seed", 0, Number.MAX_SAFE_INTEGER),
  ];
}

/* ---- the module's memory ---- */

function in_memory(place) {
  if (place === 0) throw new Error("out of memory");
  return place;
}

function text_at(wasm, place) {
  const bytes = new Uint8Array(wasm.memory.buffer, place);
  return new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
}

/* What is handed to C for one call. */
class Heap {
  constructor(wasm) {
    this.wasm = wasm;
    this.places = [];
  }

  take(bytes) {
    const place = in_memory(this.wasm.malloc(Math.max(bytes, 1)));
    this.places.push(place);
    return place;
  }

  put(array) {
    const place = this.take(array.byteLength);
    new array.constructor(this.wasm.memory.buffer, place, array.length).set(array);
    return place;
  }

  /* The number of a choice of the catalogue. */
  choice(module, name) {
    const number = this.wasm.choice(
      MODULES.indexOf(module), this.put(new TextEncoder().encode(`${name}\0`)));
    if (number < 0) throw new Error(`${module}: the catalogue has no ${name}`);
    return number;
  }

  free() {
    for (const place of this.places.splice(0)) this.wasm.free(place);
  }
}
