/* The page's check of a picture, in a worker of its own: the diagnosis of penumbra/compare/check, of
   one picture of the lab's scene. In: { file, json, lightSamples, pixelSamples }, of a scene file's
   JSON. Out: { progress }, { ask } for moments, which the page answers with { moments }, and at last
   { verdict }, { refused } (a key of REFUSALS and values) or { error }. */

const MOST_PIXELS = 1 << 21; // a page has less memory than the command, which takes four times as many
const FEWEST_CELLS = 20;

class Refused extends Error {
  constructor(code, values = {}) {
    super(code);
    Object.assign(this, { code, values });
  }
}

/* library: see View.of; progress(share). */
async function check(image, scene, lightSamples, pixelSamples, library, progress) {
  const { width, height } = image;
  if (width * height > MOST_PIXELS) throw new Refused("too large", { width, height });
  if (width < 2 * CELL || height < 2 * CELL) throw new Refused("too small", { width, height });
  const picture = readPicture(image, scene, lightSamples, pixelSamples);
  progress(0.05);
  const { grid, miss } = fitGrid(picture, scene);
  progress(0.15);
  const view = await View.of(picture, grid, scene, library, FINE_GRID);
  if (view.cells < FEWEST_CELLS) throw new Refused("too small", { width, height });
  progress(0.3);
  return verdictOf(await diagnose(view, progress), miss);
}

/* ---------------------------------------------------------------- files */

/* A PNG, JPG or BMP of 8 bits as { levels, width, height, jpeg }: its own numbers, of no profile. */
async function decode(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  const jpeg = kindOf(bytes);
  let bitmap;
  try {
    bitmap = await createImageBitmap(file, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  } catch {
    throw new Refused("unreadable");
  }
  const { width, height } = bitmap;
  if (width * height > MOST_PIXELS) throw new Refused("too large", { width, height });
  faithful();
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  context.drawImage(bitmap, 0, 0);
  const { data } = context.getImageData(0, 0, width, height);
  for (let i = 3; i < data.length; i += 4) if (data[i] < 255) throw new Refused("transparent");
  return { levels: data, width, height, jpeg };
}

/* What kind of JPEG a file is: "fine", or "coarse" (low quality, or its colours at half the
   resolution); "" of others. Refuses what is no picture, or has more than 8 bits a channel. */
function kindOf(bytes) {
  const is = (...start) => start.every((byte, i) => bytes[i] === byte);
  if (is(0x89, 0x50, 0x4e, 0x47)) {
    if (bytes[24] > 8) throw new Refused("deep");
    return "";
  }
  if (is(0x42, 0x4d)) return "";
  if (!is(0xff, 0xd8)) throw new Refused("unreadable");
  let steps = null;
  let halved = false;
  let lowest = 4;
  for (let at = 2; at + 4 < bytes.length && bytes[at] === 0xff;) {
    const marker = bytes[at + 1];
    const end = at + 2 + 256 * bytes[at + 2] + bytes[at + 3];
    for (let table = at + 4; marker === 0xdb && table < end;) {
      // DQT
      const wide = bytes[table] >> 4;
      const name = bytes[table] & 15;
      const size = wide ? 2 : 1;
      if (name < lowest) {
        lowest = name;
        steps =
          sum(
            range(64).map((i) =>
              wide ? 256 * bytes[table + 1 + 2 * i] + bytes[table + 2 + 2 * i] : bytes[table + 1 + i],
            ),
          ) / 64;
      }
      table += 1 + 64 * size;
    }
    if (marker >= 0xc0 && marker <= 0xc2) {
      // SOF: how many components, and the first one's sampling
      if (bytes[at + 9] > 3) throw new Refused("unreadable");
      halved = bytes[at + 11] !== 0x11;
    }
    if (marker === 0xda) break;
    at = end;
  }
  return steps > 6 || halved ? "coarse" : "fine";
}

/* Some browsers change what a page reads of a picture, so that nobody is told by it. */
function faithful() {
  const side = 64;
  const given = new ImageData(side, side);
  for (let i = 0; i < given.data.length; i++) given.data[i] = i % 4 === 3 ? 255 : (i * 37) % 256;
  const context = new OffscreenCanvas(side, side).getContext("2d", { willReadFrequently: true });
  context.putImageData(given, 0, 0);
  const { data } = context.getImageData(0, 0, side, side);
  if (given.data.some((level, i) => level !== data[i])) throw new Refused("changed");
}

/* ---------------------------------------------------------------- messages */

let answered = null;

function askPage(sites, domain, rays, weights, grid) {
  const { point, normal, right, down, object } = sites;
  postMessage({ ask: [{ point, normal, right, down, object }, domain, rays, weights, grid] });
  return new Promise((resolve) => {
    answered = resolve;
  });
}

onmessage = async ({ data }) => {
  if (data.moments) return answered(data.moments);
  try {
    const scene = readScene(data.json);
    const image = await decode(data.file);
    const verdict = await check(image, scene, data.lightSamples, data.pixelSamples, askPage, (progress) =>
      postMessage({ progress }),
    );
    postMessage({ verdict });
  } catch (error) {
    postMessage(
      error instanceof Refused
        ? { refused: error.code, values: error.values }
        : { error: String(error.message) },
    );
  }
};
