/* The C renderer and the library of mistakes in this page, in WebAssembly, on a few workers.
 *
 *   const core = await coreReady;
 *   const frame = await core.render(scene, settings, { client: "soft" });
 *   paint(canvas, frame);
 *
 * A scene is the object of a file scenes/*.json. A frame has
 *   width, height  [pixels]
 *   radiance       Float32Array, three planes R, G, B of width * height, rows from the top
 *   milliseconds   that C took for it, of the worker that took longest
 *   shadow_rays    asked for: N for each surface light and one for each point light, from every
 *                  pixel sample of a pixel whose centre shows a surface; 0 of "exact". Where no
 *                  light can come from or nothing can hide it, C may do without casting them
 *   background     what a pixel is that shows no surface [W m^-2 sr^-1]
 *   wraps          whether who made it saves it unclamped, so that 8 bits wrap around
 */
class Core {
  /* Rejects where there is no WebAssembly, or no worker starts. */
  static async open({ workers = Math.min(navigator.hardwareConcurrency || 2, 8) } = {}) {
    const core = new Core(workers);
    const parts = Array(workers).fill({ call: "ready" });
    await core.#run({ name: "core", parts, done: () => null });
    return core;
  }

  #workers;
  #idle;
  #waiting = []; // jobs of which parts are still to be dealt, the urgent ones first
  #modules = {}; // promises, by name
  #broken = null;

  constructor(workers) {
    const url = URL.createObjectURL(
      new Blob([document.getElementById("worker").textContent], { type: "text/javascript" }));
    this.#workers = Array.from({ length: workers }, () => new Worker(url));
    this.#idle = [...this.#workers];
    for (const worker of this.#workers) {
      worker.knows = new Set();
      worker.onmessage = ({ data }) => this.#answered(worker, data);
      worker.onerror = ({ message }) =>
        this.#fail(new Error(message || "no worker can be started"));
    }
  }

  /* A frame; settings: { width, height, nb_light_samples, samples_per_pixel, seed,
   * sampler: "independent" | "stratified" | "sobol",
   * estimator: "area" | "textbook" | "solid-angle" | "exact" }, all with defaults.
   * Of a client's requests that wait, only the newest matters: an older one resolves to null. */
  render(scene, settings = {}, { client } = {}) {
    return this.#picture("core", "render", scene, {}, settings, client);
  }

  /* The same by a renderer that makes mistakes; choices: { module: name } of catalogue.def.
   * settings: also position_x, position_y of a ray in its pixel (below 0: random), and divisor (1:
   * pixels are divided by width - 1); sampler and estimator mean nothing. */
  mistaken(scene, choices, settings = {}, { client } = {}) {
    return this.#picture("mistakes", "mistaken", scene, { choices }, settings, client);
  }

  /* mistakes_moments of mistakes.h: what a sample of scene's light number `light` brings on average
   * to receivers { point, normal, right, down: Float64Array, object: Int32Array }. Names of a
   * domain, of rays and of weights. { chance, first, second }: Float32Arrays. Frames go first. */
  async moments(scene, light, receivers, domain, rays, weights, grid) {
    const AT_ONCE = 128, n = receivers.object.length, parts = [];
    const asked = structuredClone({ call: "moments", scene, light, domain, rays, weights, grid });
    for (let before = 0; before < n; before += AT_ONCE) {
      const part = (array, size) => array.slice(size * before, size * (before + AT_ONCE));
      const { point, normal, right, down, object } = receivers;
      parts.push({ ...asked, before, receivers: {
        point: part(point, 3), normal: part(normal, 3), right: part(right, 3),
        down: part(down, 3), object: part(object, 1),
      } });
    }
    const done = (answers) => Object.fromEntries(["chance", "first", "second"].map((name) => {
      const rows = rays.length * (name === "chance" ? 1 : weights.length);
      const whole = new Float32Array(rows * n);
      answers.forEach((answer, p) => {
        const count = answer[name].length / rows;
        for (let r = 0; r < rows; r++) {
          whole.set(answer[name].subarray(r * count, (r + 1) * count), r * n + p * AT_ONCE);
        }
      });
      return [name, whole];
    }));
    return this.#run({ name: "mistakes", patient: true, parts, done });
  }

  async #picture(name, call, scene, also, wanted, client) {
    const settings = {
      ...scene.image, nb_light_samples: 64, samples_per_pixel: 1, seed: 0, sampler: "independent",
      estimator: "area", position_x: 0.5, position_y: 0.5, divisor: 0, ...wanted,
    };
    const { width, height } = settings, step = this.#workers.length;
    const asked = structuredClone({ call, scene, settings, step, ...also }); // as they are now
    const parts = this.#workers.map((_, first) => ({ ...asked, first }));
    return this.#run({ name, client, parts, done: (answers) => {
      const radiance = new Float32Array(3 * width * height);
      for (const { rows, first } of answers) {
        const count = rows.length / (3 * width);
        for (let c = 0; c < 3; c++) {
          for (let k = 0; k < count; k++) {
            const at = (c * count + k) * width;
            radiance.set(rows.subarray(at, at + width), (c * height + first + k * step) * width);
          }
        }
      }
      return {
        width, height, radiance, background: asked.scene.background,
        milliseconds: Math.max(...answers.map((answer) => answer.milliseconds)),
        shadow_rays: answers.reduce((sum, answer) => sum + answer.shadow_rays, 0),
        wraps: answers[0].wraps ?? false,
      };
    } });
  }

  /* ---- jobs: parts that are dealt to the workers as these get free ---- */

  async #run(job) {
    if (job.parts.length === 0) return job.done([]);
    const module = await (this.#modules[job.name] ??= compiled(job.name));
    return new Promise((resolve, reject) => {
      if (this.#broken) return reject(this.#broken);
      const missing = job.parts.length;
      Object.assign(job, { module, resolve, reject, dealt: 0, missing, answers: [] });
      const older = this.#waiting.find(
        (other) => job.client !== undefined && other.client === job.client && other.dealt === 0);
      if (older) {
        this.#waiting.splice(this.#waiting.indexOf(older), 1, job);
        older.resolve(null);
      } else {
        const place = job.patient ? -1 : this.#waiting.findIndex((other) => other.patient);
        this.#waiting.splice(place < 0 ? this.#waiting.length : place, 0, job);
      }
      this.#deal();
    });
  }

  #deal() {
    while (this.#idle.length > 0 && this.#waiting.length > 0) {
      const worker = this.#idle.shift(), job = this.#waiting[0], part = job.dealt++;
      if (job.dealt === job.parts.length) this.#waiting.shift();
      worker.job = job;
      worker.part = part;
      const module = worker.knows.has(job.name) ? undefined : job.module;
      worker.knows.add(job.name);
      worker.postMessage({ ...job.parts[part], name: job.name, module });
    }
  }

  #answered(worker, answer) {
    const { job, part } = worker;
    this.#idle.push(worker);
    if (answer.error !== undefined) {
      this.#waiting = this.#waiting.filter((other) => other !== job);
      job.reject(new Error(answer.error));
    } else {
      job.answers[part] = answer;
      job.missing--;
    }
    this.#deal();
    if (job.missing > 0) return;
    try {
      job.resolve(job.done(job.answers));
    } catch (error) {
      job.reject(error); // no memory for the whole
    }
  }

  #fail(error) {
    this.#broken = error;
    for (const job of [...this.#waiting, ...this.#workers.map((worker) => worker.job)]) {
      job?.reject(error);
    }
    this.#waiting = [];
  }
}

/* A module that stands in the page, as gzip in base64. */
async function compiled(name) {
  const text = atob(document.getElementById(`${name}-wasm`).textContent);
  const packed = Uint8Array.from(text, (character) => character.charCodeAt(0));
  const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return WebAssembly.compile(await new Response(unpacked).arrayBuffer());
}

/* The page's own; who waits for it hears of a failure. */
const coreReady = Core.open();
coreReady.catch(() => {});

/* On a canvas, as the lab saves a picture: clamped to [0, 1], times 255, truncated, no gamma. */
function paint(canvas, { width, height, radiance, wraps }) {
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const image = new ImageData(width, height), pixels = width * height;
  for (let c = 0; c < 3; c++) {
    for (let i = 0; i < pixels; i++) {
      const value = radiance[c * pixels + i], level = value > 0 ? Math.fround(255 * value) : 0;
      image.data[4 * i + c] = wraps ? level & 255 : Math.min(255, level) | 0;
    }
  }
  for (let i = 0; i < pixels; i++) image.data[4 * i + 3] = 255;
  canvas.getContext("2d").putImageData(image, 0, 0);
}

/* The root of rel_mse (penumbra/compare/measure/metrics.py) over the colours that are lit: those
 * above 0 in the exact image, of pixels that show a surface. */
function relativeError({ radiance }, exact) {
  const EPSILON = 1e-2; // its REL_MSE_EPSILON
  const pixels = exact.width * exact.height, background = exact.background.map(Math.fround);
  let sum = 0, count = 0;
  for (let i = 0; i < pixels; i++) {
    const at = [i, pixels + i, 2 * pixels + i];
    if (at.every((place, c) => exact.radiance[place] === background[c])) continue;
    for (const place of at) {
      const right = exact.radiance[place];
      if (right <= 0) continue;
      sum += (radiance[place] - right) ** 2 / (right ** 2 + EPSILON);
      count++;
    }
  }
  return count > 0 ? Math.sqrt(sum / count) : 0;
}
