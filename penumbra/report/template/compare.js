// The image comparer: two HDR images side by side in one canvas. No library, no network.
// Its words are said by words.js.
"use strict";

(() => {
  const root = document.getElementById("comparer");
  const images = JSON.parse(document.getElementById("comparer-images").textContent);
  const $ = (name) => root.querySelector(`[data-part="${name}"]`);
  const canvas = $("canvas");
  const context = canvas.getContext("2d");

  // The canvas has this many pixels an image pixel at zoom 1, so that the browser's own
  // rescaling of the canvas blurs the edges of image pixels, never image pixels together.
  const SUPERSAMPLING = 3;

  const state = {
    a: 0, b: 0, mode: "split",
    split: 0.5,                // [0, 1] of the canvas
    stops: 0, gainStops: 4,
    zoom: 1, left: 0, top: 0,  // of the view [image pixels]
    x: 0, y: 0,                // the inspected pixel
  };

  // ---- pixels ---------------------------------------------------------------------------

  const halves = new Float32Array(65536);
  for (let bits = 0; bits < 65536; ++bits) {
    const sign = bits & 0x8000 ? -1 : 1, exponent = (bits >> 10) & 31, fraction = bits & 1023;
    halves[bits] = sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024)
                                    : 2 ** -14 * (fraction / 1024));
  }

  const decoded = new Map();

  // Interleaved linear RGB. See packed_halves in figures.py for the layout.
  function pixelsOf(index) {
    if (!decoded.has(index)) decoded.set(index, decode(images[index]));
    return decoded.get(index);
  }

  async function decode(image) {
    const bytes = Uint8Array.from(atob(image.data), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    const count = image.width * image.height;
    const rgb = new Float32Array(3 * count);
    for (let channel = 0; channel < 3; ++channel) {
      const high = 2 * channel * count, low = high + count;
      for (let i = 0; i < count; ++i)
        rgb[3 * i + channel] = halves[(planes[high + i] << 8) | planes[low + i]];
    }
    return rgb;
  }

  // As the lab shows radiance: clamped to [0, 1], times 255, truncated, no gamma.
  function toneMap(rgb, exposure, out) {
    for (let i = 0, o = 0; i < rgb.length; i += 3, o += 4) {
      for (let c = 0; c < 3; ++c)
        out[o + c] = Math.floor(255 * Math.min(1, Math.max(0, rgb[i + c] * exposure)));
      out[o + 3] = 255;
    }
  }

  const ABOVE = [255, 160, 40], BELOW = [90, 150, 255];

  // Orange where A is brighter than B, blue where it is darker, black where they are equal.
  function differenceMap(a, b, gain, out) {
    for (let i = 0, o = 0; i < a.length; i += 3, o += 4) {
      const d = gain * ((a[i] + a[i + 1] + a[i + 2]) - (b[i] + b[i + 1] + b[i + 2])) / 3;
      const colour = d > 0 ? ABOVE : BELOW, strength = Math.min(1, Math.abs(d));
      for (let c = 0; c < 3; ++c) out[o + c] = Math.round(colour[c] * strength);
      out[o + 3] = 255;
    }
  }

  function picture(image, fill) {
    const data = new ImageData(image.width, image.height);
    fill(data.data);
    const offscreen = document.createElement("canvas");
    offscreen.width = image.width;
    offscreen.height = image.height;
    offscreen.getContext("2d").putImageData(data, 0, 0);
    return offscreen;
  }

  // ---- drawing --------------------------------------------------------------------------

  let drawing = null;

  function refresh() {
    if (!drawing) drawing = requestAnimationFrame(() => { drawing = null; draw(); });
  }

  const sameSize = () => images[state.a].width === images[state.b].width
                      && images[state.a].height === images[state.b].height;
  const current = () => images[state.mode === "b" ? state.b : state.a];

  async function draw() {
    let a, b;
    try {
      [a, b] = await Promise.all([pixelsOf(state.a), pixelsOf(state.b)]);
    } catch (error) {
      $("note").textContent = say("This browser cannot unpack the images ({reason}).",
                                  { reason: error.message });
      return;
    }
    if (!sameSize() && (state.mode === "split" || state.mode === "difference")) {
      state.mode = "a";
    }
    const image = current(), other = images[state.b];
    if (canvas.width !== image.width * SUPERSAMPLING) canvas.width = image.width * SUPERSAMPLING;
    if (canvas.height !== image.height * SUPERSAMPLING)
      canvas.height = image.height * SUPERSAMPLING;
    clampView(image);

    const exposure = 2 ** state.stops, gain = 2 ** state.gainStops;
    const show = (source) => {
      context.drawImage(source, state.left, state.top, image.width / state.zoom,
                        image.height / state.zoom, 0, 0, canvas.width, canvas.height);
    };
    context.imageSmoothingEnabled = false;
    if (state.mode === "difference") {
      show(picture(image, (out) => differenceMap(a, b, gain, out)));
    } else {
      show(picture(image, (out) => toneMap(state.mode === "b" ? b : a, exposure, out)));
    }
    if (state.mode === "split") {
      const edge = Math.round(state.split * canvas.width);
      context.save();
      context.beginPath();
      context.rect(edge, 0, canvas.width - edge, canvas.height);
      context.clip();
      show(picture(other, (out) => toneMap(b, exposure, out)));
      context.restore();
    }
    describe(image, a, b);
    root.dataset.drawn = String(Number(root.dataset.drawn || 0) + 1);
  }

  // ---- words and numbers around the canvas ----------------------------------------------

  const number = (v) => (v === 0 ? "0" : Math.abs(v) < 1e-3 || Math.abs(v) >= 1e4
    ? localised(v.toExponential(3)) : localised(v.toPrecision(4))).replace("-", "\u2212");

  function describe(image, a, b) {
    const { mode, split, stops, gainStops } = state;
    for (const radio of root.querySelectorAll('input[name="mode"]')) {
      radio.checked = radio.value === mode;
      radio.disabled = !sameSize() && (radio.value === "split" || radio.value === "difference");
    }
    $("note").textContent = sameSize() ? "" :
      say("The two images differ in size: flip between them; split and difference need equal sizes.");
    $("a").value = state.a;
    $("b").value = state.b;
    $("split").value = Math.round(100 * split);
    $("split").disabled = mode !== "split";
    $("split-value").textContent = localised(`${Math.round(100 * split)} %`);
    $("exposure").value = stops;
    $("exposure").disabled = mode === "difference";
    $("exposure-value").textContent = say("{count} stops (×{factor})",
                                          { count: signed(stops), factor: factor(2 ** stops) });
    $("gain").value = gainStops;
    $("gain").disabled = mode !== "difference";
    $("gain-value").textContent = `\u00d7${factor(2 ** gainStops)}`;
    for (const slider of ["split", "exposure", "gain"])
      $(slider).setAttribute("aria-valuetext", $(`${slider}-value`).textContent);
    $("zoom-value").textContent = `\u00d7${state.zoom}`;
    $("legend").hidden = mode !== "difference";
    for (const end of root.querySelectorAll("[data-end]"))
      end.textContent = `${end.dataset.end}${factor(2 ** -gainStops)}`;
    $("divider").hidden = mode !== "split";
    $("divider").style.left = `${100 * split}%`;
    $("label-a").hidden = mode === "b" || mode === "difference";
    $("label-b").hidden = mode === "a" || mode === "difference";
    $("label-a").textContent = `A  ${images[state.a].label}`;
    $("label-b").textContent = `B  ${images[state.b].label}`;

    const cell = canvas.clientWidth / image.width * state.zoom;
    const marker = $("marker");
    const size = Math.max(cell, 7), centre = (size - cell) / 2;
    marker.style.width = marker.style.height = `${size}px`;
    marker.style.left = `${(state.x - state.left) * cell - centre}px`;
    marker.style.top = `${(state.y - state.top) * cell - centre}px`;

    $("pixel").textContent = say("pixel ({x}, {y})", { x: state.x, y: state.y });
    const inB = state.x < images[state.b].width && state.y < images[state.b].height;
    const inA = state.x < images[state.a].width && state.y < images[state.a].height;
    ["R", "G", "B"].forEach((channel, c) => {
      const va = inA ? a[3 * (state.y * images[state.a].width + state.x) + c] : NaN;
      const vb = inB ? b[3 * (state.y * images[state.b].width + state.x) + c] : NaN;
      const both = sameSize();
      set(`a-${channel}`, va);
      set(`b-${channel}`, vb);
      set(`d-${channel}`, both ? va - vb : NaN);
    });
    const labels = { a: images[state.a].label, b: images[state.b].label };
    canvas.setAttribute("aria-label",
      mode === "split" ? say("Image comparer, showing {a} against {b}, split", labels)
      : mode === "difference" ? say("Image comparer, showing {a} against {b}, difference", labels)
      : say("Image comparer, showing {image}", { image: labels[mode] }));
  }

  function set(part, value) {
    const cell = $(part);
    cell.textContent = Number.isNaN(value) ? "\u2013" : number(value);
    cell.dataset.value = value;
  }

  const signed = (v) => localised(v > 0 ? `+${v}` : `${v}`.replace("-", "\u2212"));
  const factor = (v) => localised(v >= 100 ? v.toFixed(0) : Number(v.toPrecision(3)));

  function speak() {
    const [a, b] = ["a", "b"].map((image) =>
      ["R", "G", "B"].map((c) => $(`${image}-${c}`).textContent).join(" "));
    $("spoken").textContent = say("{pixel}: A {a}; B {b}", { pixel: $("pixel").textContent, a, b });
  }

  // ---- the view -------------------------------------------------------------------------

  const clamp = (v, low, high) => Math.min(high, Math.max(low, v));

  // The view starts on a pixel of the screen, so that image pixels have equal sizes.
  function clampView(image) {
    const { zoom } = state;
    state.left = Math.round(clamp(state.left, 0, image.width * (1 - 1 / zoom)) * zoom) / zoom;
    state.top = Math.round(clamp(state.top, 0, image.height * (1 - 1 / zoom)) * zoom) / zoom;
    state.x = clamp(state.x, 0, image.width - 1);
    state.y = clamp(state.y, 0, image.height - 1);
  }

  // Zoom about the inspected pixel, which stays where it is on the screen.
  function zoomTo(zoom) {
    const old = state.zoom;
    state.zoom = clamp(zoom, 1, 32);
    state.left = state.x + 0.5 - (state.x + 0.5 - state.left) * old / state.zoom;
    state.top = state.y + 0.5 - (state.y + 0.5 - state.top) * old / state.zoom;
    canvas.style.touchAction = state.zoom > 1 ? "none" : "pan-y";
    refresh();
  }

  function inspect(x, y) {
    const image = current();
    state.x = clamp(x, 0, image.width - 1);
    state.y = clamp(y, 0, image.height - 1);
    const width = image.width / state.zoom, height = image.height / state.zoom;
    state.left = clamp(state.left, state.x + 1 - width, state.x);
    state.top = clamp(state.top, state.y + 1 - height, state.y);
  }

  function flip() {
    state.mode = state.mode === "a" ? "b" : "a";
    refresh();
  }

  function swap() {
    [state.a, state.b] = [state.b, state.a];
    refresh();
  }

  function choose(mode) {
    state.mode = mode;
    refresh();
  }

  // ---- controls -------------------------------------------------------------------------

  for (const which of ["a", "b"]) {
    const groups = new Map();
    images.forEach((image, index) => {
      if (!groups.has(image.group)) {
        const group = document.createElement("optgroup");
        group.label = image.group;
        groups.set(image.group, group);
        $(which).append(group);
      }
      groups.get(image.group).append(new Option(image.label, index));
    });
    $(which).addEventListener("change", (e) => { state[which] = +e.target.value; refresh(); });
  }
  for (const radio of root.querySelectorAll('input[name="mode"]'))
    radio.addEventListener("change", () => choose(radio.value));
  $("flip").addEventListener("click", flip);
  $("swap").addEventListener("click", swap);
  $("split").addEventListener("input", (e) => { state.split = e.target.value / 100; refresh(); });
  $("exposure").addEventListener("input", (e) => { state.stops = +e.target.value; refresh(); });
  $("gain").addEventListener("input", (e) => { state.gainStops = +e.target.value; refresh(); });
  $("zoom-in").addEventListener("click", () => zoomTo(state.zoom * 2));
  $("zoom-out").addEventListener("click", () => zoomTo(state.zoom / 2));

  const KEYS = {
    f: flip, x: swap, s: () => choose("split"), d: () => choose("difference"),
    a: () => choose("a"), b: () => choose("b"),
    "+": () => zoomTo(state.zoom * 2), "=": () => zoomTo(state.zoom * 2),
    "-": () => zoomTo(state.zoom / 2),
  };
  const ARROWS = {
    ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1],
  };
  canvas.addEventListener("keydown", async (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = ARROWS[event.key], action = KEYS[event.key.toLowerCase()];
    if (arrow) {
      const step = event.shiftKey ? 10 : 1;
      inspect(state.x + step * arrow[0], state.y + step * arrow[1]);
      event.preventDefault();
      await draw();
      speak();
    } else if (action) {
      event.preventDefault();
      action();
    }
  });

  function place(event) {
    const box = canvas.getBoundingClientRect(), image = current();
    const u = (event.clientX - box.left) / box.width, v = (event.clientY - box.top) / box.height;
    return {
      u,
      x: Math.floor(state.left + u * image.width / state.zoom),
      y: Math.floor(state.top + v * image.height / state.zoom),
      near: Math.abs(u - state.split) * box.width < 16,
      perPixel: image.width / state.zoom / box.width,
    };
  }

  let drag = null;
  canvas.addEventListener("pointerdown", (event) => {
    const at = place(event);
    const divides = state.mode === "split" && (at.near || state.zoom === 1);
    drag = { divides, x: event.clientX, y: event.clientY, left: state.left, top: state.top };
    canvas.setPointerCapture(event.pointerId);
    if (divides) state.split = clamp(at.u, 0, 1);
    inspect(at.x, at.y);
    refresh();
  });
  canvas.addEventListener("pointermove", (event) => {
    const at = place(event);
    if (drag && drag.divides) {
      state.split = clamp(at.u, 0, 1);
    } else if (drag) {
      state.left = drag.left - (event.clientX - drag.x) * at.perPixel;
      state.top = drag.top - (event.clientY - drag.y) * at.perPixel;
    }
    state.x = at.x;
    state.y = at.y;
    refresh();
  });
  for (const end of ["pointerup", "pointercancel"])
    canvas.addEventListener(end, () => { drag = null; });

  // Links elsewhere in the page that open a pair here.
  for (const link of document.querySelectorAll("[data-compare-a]")) {
    link.addEventListener("click", (event) => {
      event.preventDefault();  // following the link would take the focus from the canvas
      state.a = +link.dataset.compareA;
      state.b = +link.dataset.compareB;
      state.mode = link.dataset.compareMode || "split";
      refresh();
      document.getElementById("compare").scrollIntoView();
      canvas.focus({ preventScroll: true });
    });
  }

  state.a = +root.dataset.a;
  state.b = +root.dataset.b;
  state.x = +root.dataset.x;
  state.y = +root.dataset.y;
  new ResizeObserver(refresh).observe(canvas);
  draw();
})();
