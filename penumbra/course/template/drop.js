/* "Drop your image here": asks for a picture, has check/*.js judge it in a worker, and says what
   `penumbra check` would say. checkPicture(file, { scene, lightSamples, pixelSamples, progress })
   is all that the page's tests call. */

const DROP = JSON.parse(document.getElementById("drop-data").textContent);
Object.assign(MESSAGES, DROP.messages);

class RefusedPicture extends Error {
  constructor(code, values) {
    super(code);
    Object.assign(this, { code, values });
  }
}

/* A verdict (check/verdict.js). scene: of DROP.scenes. Rejects with a RefusedPicture. */
function checkPicture(
  file,
  { scene = "tp3", lightSamples, pixelSamples = 1, progress = () => {}, signal = null },
) {
  const url = URL.createObjectURL(
    new Blob([document.getElementById("check-worker").textContent], { type: "text/javascript" }),
  );
  const worker = new Worker(url);
  const json = DROP.scenes[scene];
  URL.revokeObjectURL(url);
  return new Promise((resolve, reject) => {
    if (signal) signal.addEventListener("abort", () => reject(new DOMException("stopped", "AbortError")));
    worker.onerror = (event) => reject(new Error(event.message));
    worker.onmessage = async ({ data }) => {
      if (data.progress !== undefined) progress(data.progress);
      else if (data.verdict) resolve(data.verdict);
      else if (data.refused) reject(new RefusedPicture(data.refused, data.values));
      else if (data.error) reject(new Error(data.error));
      else {
        try {
          const core = await coreReady;
          worker.postMessage({ moments: await core.moments(json, 0, ...data.ask) });
        } catch (error) {
          reject(error);
        }
      }
    };
    worker.postMessage({ file, json, lightSamples, pixelSamples });
  }).finally(() => worker.terminate());
}

/* Light samples and samples per pixel that a file's name states, as n016_aa01.png does; null where it
   does not, or contradicts itself. The patterns of penumbra/compare/check/picture.py. */
function countsInName(name) {
  const COUNT = "[ _=-]?(\\d{1,6})(?![0-9a-z]|\\.\\d)";
  const LIGHT = `(?:(?<![a-z])n|(?:nb)?_?light_?samples)${COUNT}`;
  const PIXEL =
    `(?:(?<![a-z])aa|(?<![a-z])spp|(?:nb)?_?pixel_?samples|samples_?per_?pixel)${COUNT}` +
    `|(?<![a-z])n[ _=-]?\\d+[ _-]?m${COUNT}`;
  const PER_PIXEL = "(?<![0-9a-z.])(\\d{1,6})_?spp(?![0-9a-z])";
  const stem = name.replace(/\.[A-Za-z]\w*$/, "").toLowerCase();
  const found = (pattern) =>
    [...stem.matchAll(new RegExp(pattern, "g"))].map((match) => Number(match.slice(1).find(Boolean)));
  const stated = (counts) => (new Set(counts).size === 1 ? counts[0] || null : null);
  const glued = /(?<![a-z])n(\d{1,6})m(\d{1,6})(?![0-9a-z])/.exec(stem);
  if (glued) return [Number(glued[1]) || null, Number(glued[2]) || null];
  const light = stated(found(LIGHT));
  // "64spp" alone might mean either
  const pixel = [...found(PIXEL), ...(light === null ? [] : found(PER_PIXEL))];
  return [light, stated(pixel)];
}

{
  const WORDS = DROP.words;
  const MISTAKES = DROP.mistakes;
  const UNKNOWN = "unknown";
  const NO_EFFECT = "n_no_effect";
  const MARKS = { right: "✓", wrong: "✕", "cannot tell": "?" };
  const part = (name) => document.getElementById(`drop-${name}`);
  const word = (key, values) => say(WORDS[key], values);
  const listed = ({ list, format }) => list.map((x) => number(x, format)).join(say(", "));
  const placed = (object) => {
    const [of_object, on_object] = DROP.objects[object].map((text) => say(text));
    return { of_object, on_object };
  };

  /* Of the picture, no faults of the light. */
  const FACTS = {
    pixel_corner: () => say("your rays go through the corner of each pixel, not its centre"),
    divided_by_w_minus_1: () => say("your pixel coordinates are divided by W - 1 and H - 1, not W and H"),
    jittered: () => say("your rays go through a random place of each pixel"),
    ray_cut: (v) => say("your camera rays end at about {cut:g} m, the scene's at {stated:g} m", v),
    ray_far: (v) => say("your camera rays end at 1 km or farther, the scene's at {stated:g} m", v),
    shift: (v) => say("your picture is shifted by ({x:g}, {y:g}) pixels", v),
    fov: (v) => say("your camera's field of view is {fov:.1f} degrees, the scene's is {stated:g}", v),
    forward: (v) => say("your camera is {moved:g} m further forward than the scene's", v),
    back: (v) => say("your camera is {moved:g} m further back than the scene's", v),
    aspect: (v) => say("your picture is stretched horizontally, by {aspect:.2f}", v),
    flip_x: () => say("your picture is mirrored, left for right"),
    flip_y: () => say("your picture is upside down"),
    transfer: (v) =>
      say("your picture went through a curve ({curve}); the lab saves linear values", {
        curve: say(v.curve),
      }),
    no_background: () => say("your picture shows no background where the scene has it"),
    background: (v) =>
      say("your picture's background is ({mine}), the scene's is ({want})", {
        mine: listed(v.mine),
        want: listed(v.want),
      }),
    colours: ({ object, colour, stated }) =>
      word("colours", { ...placed(object), colour: listed(colour), stated: listed(stated) }),
  };
  const fact = ({ text, values }) => (text in FACTS ? FACTS[text](values) : word(text, values));

  const REFUSALS = {
    unreadable: () =>
      say(
        "This is no picture that the page can read. Give a PNG, JPG or BMP file; for other formats run “penumbra check”.",
      ),
    deep: () =>
      say(
        "This PNG has more than 8 bits a channel, and the page reads 8. Save it with 8 bits, or run “penumbra check”.",
      ),
    transparent: () =>
      say(
        "This picture is partly transparent, and a page cannot read the colours under that. Save it without transparency.",
      ),
    "too large": (v) =>
      say("{width} x {height} pixels are more than the page can check. Render 600 x 400.", v),
    "too small": (v) => say("{width} x {height} pixels are too few to tell anything. Render 600 x 400.", v),
    changed: () =>
      say(
        "This browser changes what a page reads of a picture, to protect your privacy. Nothing can be said of it here: try another browser, or run “penumbra check”.",
      ),
  };

  // ---------------------------------------------------------------- the verdict in words

  const title = (name) => (name === UNKNOWN ? say("unknown") : say(MISTAKES[name].title));
  const titles = (names) => names.map(title).join(" + ") || say("no mistake");

  function made(tag, given = {}, ...children) {
    const node = Object.assign(document.createElement(tag), given);
    node.append(...children.filter((child) => child !== null));
    return node;
  }

  const lines = (texts) => made("ul", {}, ...texts.map((text) => made("li", {}, text)));

  /* What the picture shows: the parts that are off, the worst first. */
  function observations(found) {
    const said = [];
    for (const { kind, object, ratio, standardError, trend } of found.regions) {
      const region = word(`region_${kind}`, placed(object));
      const off = Math.abs(ratio - 1);
      if (kind === "shadow") {
        if (ratio > 1.5 / 255)
          said.push([ratio * 10, word("region_not_black", { region, value: 255 * ratio })]);
      } else if (off > Math.max(4 * standardError, 0.006)) {
        let text = word(ratio > 1 ? "region_bright" : "region_dark", { region, ratio });
        if (Math.abs(trend) > 0.1 && off > 0.03)
          text += word(trend > 0 === ratio > 1 ? "farther_more" : "farther_less");
        said.push([off, text]);
      }
    }
    if (found.beside > 0.05) said.push([2, word("free_light", { outside: found.beside })]);
    const { lightSamples: n, effectiveSamples: effective } = found;
    if (effective < 0.7 * n && n > 1)
      said.push([1, word("noise_of", { n, effective: Math.max(effective, 1) })]);
    return said
      .sort((a, b) => b[0] - a[0])
      .slice(0, 4)
      .map(([, text]) => text);
  }

  function headline(found) {
    return word(
      found.verdict === "right" && found.hidden.includes(NO_EFFECT) ? "right in brightness" : found.verdict,
    );
  }

  function confidence({ confidence: share }) {
    return share > 0.999 ? word("sure") : word("confidence", { share });
  }

  function detection(found) {
    const brightness = localised(formatted(100 * found.detectableBrightness, ".2g") + "%");
    if (found.lightSamples === 1 || found.detectableSamples < 1)
      return word("detectable_mean", { brightness });
    return word("detectable", {
      brightness,
      samples: Math.ceil(found.detectableSamples),
      n: found.lightSamples,
    });
  }

  /* One mistake: its name, cause, the two formulas, what to reread, and its exhibit. */
  function mistake(name, found, hint) {
    if (name === UNKNOWN) {
      const nearest =
        found.perhaps.length && !found.several
          ? made("p", {}, word("nearest", { title: titles(found.perhaps) }))
          : null;
      return made(
        "div",
        { className: "mistake" },
        made("p", {}, word(found.loose >= 0.005 ? "unknown" : "unknown_places", found)),
        nearest,
      );
    }
    const { cause, wrong, right, step, look } = MISTAKES[name];
    const deep = hint >= 3;
    const formula = (key, text) => [
      made("dt", {}, word(key).trim()),
      made("dd", {}, made("code", {}, say(text))),
    ];
    return made(
      "div",
      { className: "mistake" },
      made("h4", {}, title(name)),
      made("p", {}, say(cause)),
      deep ? made("dl", {}, ...formula("yours", wrong), ...formula("ours", right)) : null,
      made("p", {}, word("reread", { step: say(step) })),
      deep ? made("p", {}, word("look", { look: say(look) })) : null,
      made("p", {}, made("a", { href: `#mistake-${name}` }, say("See this mistake in the museum"))),
    );
  }

  /* hint: 0 verdict, 1 where to look, 2 the handout's step and the mistake's name, 3 the formula and
     the evidence. */
  function explanation(found, hint) {
    const parts = [];
    const seen = observations(found);
    const add = (heading, ...nodes) => parts.push(made("h3", {}, heading), ...nodes);
    if (hint === 0) return parts;
    const known = found.mistakes.filter((name) => name !== UNKNOWN);
    if (found.verdict === "wrong" && hint === 1) {
      const dim = found.regions
        .filter(({ kind }) => kind === "lit")
        .every(({ ratio }) => Math.abs(ratio - 1) < 0.01);
      parts.push(made("p", {}, word("hint", { where: word(dim ? "hint_noise" : "hint_mean") })));
      if (known.length) parts.push(lines([...new Set(known.map((name) => say(MISTAKES[name].step)))]));
    } else if (found.verdict === "wrong") {
      if (seen.length) add(word("observed"), lines(seen));
      add(
        word(found.several ? "several" : "cause"),
        ...found.mistakes.map((name) => mistake(name, found, hint)),
      );
      if (found.perhaps.length && !found.mistakes.includes(UNKNOWN))
        parts.push(made("p", {}, word("perhaps") + " " + titles(found.perhaps)));
      if (hint >= 3 && found.alike.length)
        parts.push(made("p", {}, word("alike", { titles: found.alike.map(titles).join(say("; ")) })));
      if (hint >= 3 && found.runnersUp.length && !found.mistakes.includes(UNKNOWN)) {
        const odds = (value) => (value < 1e4 ? number(value, ".0f") : `10^${Math.round(Math.log10(value))}`);
        add(
          word("runners"),
          lines(
            found.runnersUp.map((other) =>
              word("odds", { odds: odds(other.odds), titles: titles(other.names) }),
            ),
          ),
        );
      }
    } else if (
      seen.length &&
      found.verdict === "cannot tell" &&
      !found.facts.some(({ code }) => code === "geometry")
    ) {
      add(word("observed"), lines(seen));
    }
    if (found.facts.length) add(word("picture"), lines(found.facts.map(fact)));
    if (found.verdict === "right") {
      parts.push(made("p", {}, detection(found)));
      if (found.hidden.length && hint >= 2)
        parts.push(made("p", {}, word("hidden", { mistakes: found.hidden.map(title).join(say("; ")) })));
    }
    if (found.settle.length && found.verdict !== "wrong") {
      const what = found.settle.map(({ text, values }) => word(text, values)).join(say("; or "));
      parts.push(made("p", {}, word(found.verdict === "right" ? "more" : "settle", { what })));
    }
    return parts;
  }

  // ---------------------------------------------------------------- pictures

  /* The scene through the camera that the picture has. */
  function seenBy({ grid, scene: name }) {
    const scene = structuredClone(DROP.scenes[name]);
    const { camera } = scene;
    camera.fov_y_deg = grid.fovY;
    camera.position[2] += grid.moved;
    camera.look_at[2] += grid.moved;
    scene.ray_max_distance = grid.cut;
    return scene;
  }

  function pane(canvas, caption, label) {
    spoken(canvas, label, "aria-label");
    canvas.setAttribute("role", "img");
    return made("figure", {}, canvas, spoken(made("figcaption"), caption));
  }

  /* The picture, the right one in its size and, of a known mistake, what makes it. */
  async function pictures(bitmap, found) {
    const { width, height } = bitmap;
    const yours = made("canvas", { width, height });
    const scene = seenBy(found);
    const core = await coreReady;
    yours.getContext("2d").drawImage(bitmap, 0, 0);
    if (found.verdict === "right") for (const light of scene.quad_lights) light.power *= found.variant.factor;
    const panes = [
      pane(
        yours,
        () => say("Your picture"),
        () => say("Your picture"),
      ),
    ];
    const right = made("canvas");
    paint(
      right,
      await core.render(scene, {
        width,
        height,
        estimator: "exact",
        nb_light_samples: 1,
        samples_per_pixel: 1,
      }),
    );
    panes.push(
      pane(
        right,
        () => say("The right picture, without noise"),
        () => say("The right picture, in the size of yours"),
      ),
    );
    if (found.mistakes.length && !found.mistakes.includes(UNKNOWN)) {
      const { factor, ...choices } = found.variant;
      const { position, divisor, jittered } = found.grid;
      const mistaken = made("canvas");
      for (const light of scene.quad_lights) light.power *= factor;
      const place = jittered ? -1 : position;
      paint(
        mistaken,
        await core.mistaken(scene, choices, {
          width,
          height,
          nb_light_samples: Math.min(found.lightSamples, 256),
          samples_per_pixel: Math.min(found.pixelSamples, 4),
          position_x: place,
          position_y: place,
          divisor,
        }),
      );
      panes.push(
        pane(
          mistaken,
          () => say("What explains yours best: a program with what is named above"),
          () => say("What a program with these mistakes makes"),
        ),
      );
    }
    return made("div", { className: "pictures" }, ...panes);
  }

  // ---------------------------------------------------------------- the form

  const state = { file: null, found: null, failed: null, beside: null, running: null };

  function show() {
    const { found, failed, running } = state;
    const result = part("result");
    const hint = Number(part("hint").value);
    part("status").className = failed ? "failed" : found ? found.verdict.replace(" ", "-") : "";
    part("progress").hidden = !running;
    result.hidden = !found;
    result.replaceChildren();
    if (running) part("status").textContent = say("Checking {file}…", { file: state.file.name });
    else if (failed) part("status").textContent = failed();
    else if (found) {
      const sure =
        found.verdict === "cannot tell"
          ? null
          : made("span", { className: "sure" }, ` (${confidence(found)})`);
      const mark = made("span", { className: "mark" }, MARKS[found.verdict]);
      mark.setAttribute("aria-hidden", "true");
      part("status").replaceChildren(mark, made("span", {}, headline(found)), ...(sure ? [sure] : []));
      result.append(...explanation(found, hint));
      if (state.beside && hint >= 3) result.append(state.beside);
    } else part("status").textContent = "";
  }

  async function start() {
    const { file } = state;
    const n = part("n");
    const m = part("m");
    if (state.running) state.running.abort();
    Object.assign(state, { found: null, failed: null, beside: null, running: null });
    if (!file) state.failed = () => say("Choose a picture first.");
    else if (!n.checkValidity() || !n.value) {
      state.failed = () =>
        say("How many light samples has it? Type a whole number from 1 to 4096, and check it.");
      n.focus();
    } else if (!m.checkValidity() || !m.value) {
      state.failed = () => say("How many samples has each pixel? Type a whole number, 1 or more.");
      m.focus();
    }
    if (state.failed) return show();
    const running = (state.running = new AbortController());
    show();
    try {
      const found = await checkPicture(file, {
        scene: part("scene").value,
        lightSamples: Number(n.value),
        pixelSamples: Number(m.value),
        signal: running.signal,
        progress: (share) => {
          if (state.running === running) part("progress").value = share;
        },
      });
      const beside = await pictures(await createImageBitmap(file), found);
      if (state.running === running) Object.assign(state, { found, beside });
    } catch (error) {
      if (state.running === running) {
        state.failed =
          error instanceof RefusedPicture
            ? () => REFUSALS[error.code](error.values)
            : () => say("The check has failed: {reason}", { reason: error.message });
      }
    }
    if (state.running === running) {
      state.running = null;
      show();
    }
  }

  /* A picture that was chosen, dropped or pasted. */
  function take(file) {
    const [n, m] = countsInName(file.name);
    state.file = file;
    part("n").value = n ?? "";
    part("m").value = m ?? 1;
    start();
  }

  function options(select, entries, chosen) {
    for (const [value, text] of entries)
      select.append(spoken(made("option", { value, selected: value === chosen }), text));
  }

  options(
    part("scene"),
    [
      ["tp3", () => say("the lab’s scene, camera at (0, 0, 0)")],
      ["tp3_statement", () => say("the handout’s camera, at (0, 0, -2)")],
    ],
    "tp3",
  );
  options(
    part("hint"),
    [
      ["0", () => say("only the verdict")],
      ["1", () => say("where to look")],
      ["2", () => say("the mistake’s name")],
      ["3", () => say("the formula and the evidence")],
    ],
    "3",
  );

  part("file").addEventListener("change", ({ target }) => {
    if (target.files.length) take(target.files[0]);
  });
  part("form").addEventListener("submit", (event) => {
    event.preventDefault();
    start();
  });
  part("form").noValidate = true;
  part("hint").addEventListener("change", show);
  document.addEventListener("penumbra:language", show);
  document.addEventListener("paste", ({ clipboardData }) => {
    if (clipboardData.files.length) take(clipboardData.files[0]);
  });
  /* A picture that misses its place must not replace the page. */
  for (const type of ["dragover", "drop"]) document.addEventListener(type, (event) => event.preventDefault());
  const article = document.getElementById("drop");
  for (const type of ["dragenter", "dragover", "dragleave", "drop"]) {
    article.addEventListener(type, () =>
      part("zone").classList.toggle("over", type === "dragover" || type === "dragenter"),
    );
  }
  article.addEventListener("drop", ({ dataTransfer }) => {
    if (dataTransfer.files.length) take(dataTransfer.files[0]);
  });

  coreReady.then(
    () => {
      part("form").hidden = false;
      part("without").hidden = true;
    },
    () => {},
  );
}
