/* A figure that renders as its controls are moved, in the place of its picture.
 *
 *   new LiveFigure(document.getElementById("figure-average"), {
 *     controls: [range("n", () => say("Shadow rays N"), { values: [1, 4, 16], value: 4 })],
 *     panes: (state) => [{ scene, settings: { nb_light_samples: state.n } }],
 *   });
 *
 * Nothing is rendered while the figure is out of sight or nothing has changed. What is costly to
 * know, the noise against the exact image, is computed when the controls rest. */

const REDUCED_MOTION = matchMedia("(prefers-reduced-motion: reduce)");
const REST = 180; // [ms] without a change, then the noise is computed
const WIDE = 460; // [CSS px] of a picture that is rendered in full size, else in half of it
let ids = 0;

/* ---- the controls' descriptions: label and shown are functions, since languages change ---- */

/* A slider over values, or from min to max by step; shown(value): what stands beside it. */
function range(name, label, { values, min, max, step, value, shown = (v) => number(v, ",d") }) {
  return { kind: "range", name, label, values, min, max, step, value, shown };
}

/* Radio buttons; options: [value, label] each. */
function choice(name, label, options, value = options[0][0]) {
  return { kind: "choice", name, label, options, value };
}

/* press(figure) */
function button(label, press) {
  return { kind: "button", label, press };
}

class LiveFigure {
  /* controls: of range, choice, button; a button "Reset" is added.
   * panes(state): [{ scene, settings, label, reference, show }]: pictures side by side.
   *   settings: core.render's but for the size; size: [width, height] or by the room there is
   *   reference: what the noise is measured against, { scene, settings } [the exact image of the
   *   scene]; null for none
   *   show(frame, exact): the frame that is painted, where it is not the frame itself
   * readouts(state, pane): [term, value] texts, below each pane [noise, time, rays]; pane: { frame,
   *   exact, noise, index }, the latter two null until the controls rest
   * rested(figure, panes): what else there is to compute then; awaited before readouts are written
   * described(): the pictures' name for who cannot see them
   * marked(state): where a ring is drawn on the first picture, as shares of it
   * again(figure): what else a reset does
   * aside: an element before the pictures; changed(state): to be redrawn with every change
   * cpp(state): the lines that add the light, for the C++ below the figure */
  constructor(figure, description) {
    Object.assign(this, { readouts: usualReadouts, described: () => say("The picture as it is rendered now") }, description);
    this.figure = figure;
    this.client = figure.id || `figure-${++ids}`;
    this.state = {};
    this.painted = 0; // frames, for those who count
    this.stale = true;
    this.exacts = new Map();
    this.refreshers = []; // what is said anew in another language
    this.shown = []; // panes on the screen
    figure.dataset.frames = 0;
    document.addEventListener("penumbra:language", () => this.#saidAnew());
    coreReady.then((core) => this.#begin(core), () => figure.classList.add("still"));
  }

  #begin(core) {
    this.core = core;
    this.#build();
    new IntersectionObserver((entries) => {
      this.visible = entries.at(-1).isIntersecting;
      this.#wake();
    }, { rootMargin: "200px" }).observe(this.figure);
    document.addEventListener("visibilitychange", () => this.#wake());
    new ResizeObserver(() => {
      const sized = this.shown.length > 0 && this.shown.every(({ pane }) => pane?.size);
      if (!sized && this.#size() !== this.sizeAtLast) this.invalidate();
    }).observe(this.stage);
  }

  /* Something has changed: render, as soon as it can be seen. */
  invalidate() {
    this.stale = true;
    clearTimeout(this.resting);
    this.#wake();
  }

  set(name, value) {
    this.state[name] = value;
    this.refresh();
    if (this.controls.find((control) => control.name === name).renders !== false) this.invalidate();
    else this.#writeReadouts();
  }

  refresh() {
    for (const refresher of this.refreshers) refresher();
    if (this.changed) this.changed(this.state, this);
    if (this.cpp) this.#writeCpp();
  }

  #saidAnew() {
    if (!this.core) return;
    this.refresh();
    this.#writeReadouts();
  }

  #wake() {
    if (!this.#due()) return;
    this.waking ||= requestAnimationFrame(() => {
      this.waking = 0;
      if (this.#due()) this.#render();
    });
  }

  #due() {
    return this.core && this.visible && !document.hidden && this.stale && !this.busy;
  }

  async #render() {
    this.stale = false;
    this.busy = true;
    this.sizeAtLast = this.#size();
    const panes = this.panes(this.state, this);
    try {
      const frames = await Promise.all(panes.map((pane, i) => this.core.render(
        pane.scene, { ...this.#settings(pane), ...pane.settings }, { client: `${this.client}-${i}` })));
      this.busy = false;
      if (this.#due()) this.#render(); // the workers go on while this frame is painted
      if (frames.every((frame) => frame)) this.#paint(panes, frames);
    } catch (error) {
      this.busy = false;
      this.#complain(error);
    }
    if (this.stale) this.#wake();
    else if (!this.busy) this.resting = setTimeout(() => this.#rest().catch((error) => this.#complain(error)), REST);
  }

  #paint(panes, frames) {
    this.#arrange(panes);
    this.shown.forEach((shown, i) => {
      Object.assign(shown, { pane: panes[i], frame: frames[i], noise: null, exact: null, index: i });
      if (!panes[i].show) paint(shown.canvas, frames[i]);
      else paint(shown.canvas, panes[i].show(frames[i], this.#known(panes[i])));
      if (panes[i].label) shown.title.textContent = panes[i].label();
    });
    this.error.hidden = true;
    this.#writeReadouts();
    this.figure.dataset.frames = ++this.painted;
  }

  /* Noise and whatever else takes longer than a frame. */
  async #rest() {
    const at = this.painted;
    for (const shown of this.shown) {
      if (shown.pane.reference === null) continue;
      const exact = await this.exact(shown.pane);
      if (!exact || this.painted !== at || this.stale) return;
      shown.exact = exact;
      shown.noise = relativeError(shown.frame, exact);
      if (shown.pane.show) paint(shown.canvas, shown.pane.show(shown.frame, exact));
    }
    if (this.rested) await this.rested(this, this.shown);
    if (this.painted !== at || this.stale) return;
    this.#writeReadouts();
    this.status.textContent = this.shown.map((shown) => [
      ...this.#said(shown).map(([term, value]) => `${term}: ${value}`)].join(", ")).join("; ");
    this.figure.dataset.rested = this.painted;
  }

  /* What the pane's noise is measured against; remembered as long as it is the same. */
  async exact(pane) {
    const { scene, settings } = pane.reference || { scene: pane.scene, settings: {} };
    const wanted = { ...this.#settings(pane), estimator: "exact", ...settings };
    const key = JSON.stringify([scene, wanted]);
    if (!this.exacts.has(key)) {
      const frame = await this.core.render(scene, wanted, { client: `${this.client}-exact` });
      if (!frame) return null;
      if (this.exacts.size >= 8) this.exacts.clear();
      this.exacts.set(key, frame);
    }
    return this.exacts.get(key);
  }

  #known(pane) {
    const { scene, settings } = pane.reference || { scene: pane.scene, settings: {} };
    return this.exacts.get(JSON.stringify([scene, { ...this.#settings(pane), estimator: "exact", ...settings }]));
  }

  #settings(pane) {
    const [width, height] = pane.size || (this.#size() === "full" ? [600, 400] : [300, 200]);
    return { width, height };
  }

  #size() {
    const width = this.shown.length ? this.shown[0].canvas.clientWidth : this.stage.clientWidth;
    return width >= WIDE ? "full" : "half";
  }

  #complain(error) {
    this.error.hidden = false;
    this.error.textContent = error.message;
  }

  /* ---- what is on the page ---- */

  #build() {
    const { figure } = this;
    this.picture = figure.querySelector("img");
    this.stage = figure.querySelector(".stage");
    this.panel = element("div", { class: "panel" });
    this.error = element("p", { class: "message", role: "alert", hidden: "" });
    this.status = element("p", { class: "hidden", role: "status" });
    for (const control of this.controls) this.panel.append(this.#control(control));
    const reset = element("button", { type: "button", class: "reset" });
    this.#written(reset, () => say("Reset"));
    reset.addEventListener("click", () => this.reset());
    (this.panel.querySelector(".buttons") || this.panel.appendChild(element("div", { class: "buttons" }))).append(reset);
    this.stage.after(this.panel, this.error, this.status);
    if (this.aside) {
      this.stage.before(this.aside);
      figure.classList.add("with-aside");
      figure.classList.toggle("with-sketch", this.aside.querySelector(".sketch") !== null);
    }
    figure.classList.add("ready");
    document.documentElement.classList.add("live");
    this.refresh();
  }

  reset() {
    for (const { name, value } of this.controls) if (name) this.state[name] = value;
    if (this.again) this.again(this);
    this.refresh();
    this.invalidate();
  }

  #control(control) {
    if (control.kind === "button") return this.#button(control);
    this.state[control.name] = control.value;
    return control.kind === "range" ? this.#range(control) : this.#choice(control);
  }

  #button({ label, press }) {
    const made = element("button", { type: "button" });
    this.#written(made, () => label(this));
    made.addEventListener("click", () => press(this));
    const row = this.panel.querySelector(".buttons") || element("div", { class: "buttons" });
    row.append(made);
    return row;
  }

  #range({ name, label, values, min, max, step, shown }) {
    const id = `control-${++ids}`, input = element("input", {
      type: "range", id, "data-name": name, min: values ? 0 : min, max: values ? values.length - 1 : max,
      step: values ? 1 : step,
    });
    const said = element("label", { for: id }), output = element("output", { for: id });
    this.#written(said, label);
    this.refreshers.push(() => {
      const value = this.state[name];
      input.value = values ? values.indexOf(value) : value;
      output.textContent = shown(value);
      input.setAttribute("aria-valuetext", shown(value));
    });
    input.addEventListener("input", () => {
      this.set(name, values ? values[input.value] : Number(input.value));
    });
    const row = element("div", { class: "control" });
    row.append(said, output, input);
    return row;
  }

  #choice({ name, label, options }) {
    const set = element("fieldset", { class: "control choice" }), group = `choice-${++ids}`;
    const legend = element("legend", {}), row = element("div", { class: "options" });
    this.#written(legend, label);
    set.append(legend, row);
    for (const [value, text] of options) {
      const option = element("label", {}), said = element("span", {});
      const input = element("input", { type: "radio", name: group, "data-name": name, value });
      this.#written(said, text);
      this.refreshers.push(() => { input.checked = this.state[name] === value; });
      input.addEventListener("change", () => this.set(name, value));
      option.append(input, said);
      row.append(option);
    }
    return set;
  }

  #written(node, text) {
    this.refreshers.push(() => { node.textContent = text(); });
  }

  /* As many canvases as there are panes; the first frame takes the picture's place. */
  #arrange(panes) {
    if (this.shown.length === panes.length) return;
    this.shown = panes.map(() => {
      const cell = element("div", { class: "pane" });
      const title = element("p", { class: "pane-title" }), holder = element("div", { class: "canvas" });
      const canvas = element("canvas", { role: "img" }), readouts = element("dl", { class: "readouts" });
      holder.append(canvas);
      cell.append(title, holder, readouts);
      return { cell, title, holder, canvas, readouts };
    });
    this.stage.replaceChildren(...this.shown.map(({ cell }) => cell));
    this.figure.dataset.panes = panes.length;
  }

  #said(shown) {
    return this.readouts(this.state, shown, this);
  }

  #writeReadouts() {
    for (const shown of this.shown) {
      if (!shown.frame) continue;
      const said = this.#said(shown);
      shown.canvas.setAttribute("aria-label", this.described());
      if (shown.readouts.children.length !== said.length) {
        shown.readouts.replaceChildren(...said.map(() => {
          const pair = element("div", {});
          pair.append(element("dt", {}), element("dd", {}));
          return pair;
        }));
      }
      said.forEach(([term, value], i) => {
        const [dt, dd] = shown.readouts.children[i].children;
        if (dt.textContent !== term) dt.textContent = term;
        if (dd.textContent !== value) dd.textContent = value;
      });
      if (shown.pane.label) shown.title.textContent = shown.pane.label();
    }
    if (this.marked && this.shown.length > 0) this.#mark();
  }

  /* A ring at marked(state): [x, y] as shares of the picture, or null. */
  #mark() {
    const { holder } = this.shown[0], place = this.marked(this.state, this);
    let ring = holder.querySelector(".ring");
    if (!place) return ring?.remove();
    if (!ring) holder.append(ring = element("span", { class: "ring" }));
    ring.style.left = `${100 * place[0]}%`;
    ring.style.top = `${100 * place[1]}%`;
  }

  #writeCpp() {
    const code = this.figure.parentElement.querySelector(".cpp code");
    if (!code) return;
    code.textContent = code.textContent.replace(
      /^(?:\/\/ (?:center|position),.*\n)?_addLight.*$/m, () => this.cpp(this.state).join("\n"));
  }
}

function usualReadouts(state, { frame, noise }) {
  return [
    [say("Noise"), noise === null ? "…" : percent(noise)],
    [say("Time"), unit(frame.milliseconds, ".1f", "ms")],
    [say("Shadow rays"), number(frame.shadow_rays, ",d")],
  ];
}

/* A share of 1 with two digits that mean something. */
function percent(share) {
  return share === 0 ? number(0, ".0%") : share < 0.0000995 ? scale(share) : share < 0.00995 ? number(share, ".2%")
    : share < 0.0995 ? number(share, ".1%") : number(share, ".0%");
}

/* Two digits and a power of ten, where a plain number would be long. */
function scale(value) {
  if (value === 0 || (Math.abs(value) >= 0.001 && Math.abs(value) < 1e5)) return number(Number(value.toPrecision(2)), ",");
  const [digits, power] = value.toExponential(1).split("e");
  return `${number(Number(digits), "")} · 10${superscript(Number(power))}`;
}

function superscript(integer) {
  return String(integer).replace(/[-0-9]/g, (c) => (c === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[c]));
}

function element(name, attributes) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

function drawn(name, attributes, text = "") {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text) made.textContent = text;
  return made;
}

/* Two logarithmic axes in an <svg>; x and y: [least, most] as powers of ten. */
class LogPlot {
  constructor(svg, { x, y, xLabel, yLabel }) {
    Object.assign(this, { svg, x, y, xLabel, yLabel, left: 92, right: 30, top: 14, bottom: 48, width: 480, height: 340 });
    svg.setAttribute("viewBox", `0 0 ${this.width} ${this.height}`);
  }

  at(x, y) {
    const { left, right, top, bottom, width, height } = this;
    const [u, v] = [[x, this.x], [y, this.y]].map(
      ([value, [least, most]]) => (Math.log10(Math.max(value, 1e-30)) - least) / (most - least));
    return [left + u * (width - left - right), height - bottom - Math.min(1.02, Math.max(-0.02, v)) * (height - top - bottom)];
  }

  /* Draws the axes and then what is given: { kind: "line" | "area" | "marks", points, name, mark } */
  draw(series) {
    const { svg, left, right, top, bottom, width, height } = this;
    svg.replaceChildren();
    const grid = drawn("g", { class: "plot-grid" });
    for (let power = this.x[0]; power <= this.x[1]; power++) {
      const [x] = this.at(10 ** power, 1);
      grid.append(drawn("line", { x1: x, x2: x, y1: top, y2: height - bottom }));
      grid.append(drawn("text", { x, y: height - bottom + 18, class: "middle" }, number(10 ** power, ",g")));
    }
    for (let power = this.y[0]; power <= this.y[1]; power++) {
      const [, y] = this.at(1, 10 ** power);
      grid.append(drawn("line", { x1: left, x2: width - right, y1: y, y2: y }));
      grid.append(drawn("text", { x: left - 8, y: y + 4, class: "end" }, share(10 ** power)));
    }
    grid.append(drawn("text", { x: (left + width - right) / 2, y: height - 8, class: "middle name" }, this.xLabel()));
    grid.append(drawn("text", { x: 14, y: (top + height - bottom) / 2, class: "middle name",
      transform: `rotate(-90 14 ${(top + height - bottom) / 2})` }, this.yLabel()));
    svg.append(grid);
    for (const { kind, points, name, mark, text } of series) {
      const places = points.map(([x, y]) => this.at(x, y));
      if (kind === "marks") {
        places.forEach(([x, y]) => svg.append(drawn("path", { d: MARKS[mark || 0], class: `mark ${name}`,
          transform: `translate(${x.toFixed(1)} ${y.toFixed(1)})` })));
      } else if (places.length > 1) {
        const d = "M" + places.map((p) => p.map((v) => v.toFixed(1)).join(" ")).join("L");
        svg.append(drawn("path", { d: kind === "area" ? d + "Z" : d, class: `${kind} ${name}` }));
      }
      if (text && places.length) {
        const [x, y] = places.at(-1);
        svg.append(drawn("text", { x: x + 8, y: y + 4, class: `series ${name}` }, text));
      }
    }
  }
}

function share(value) {
  return value >= 0.0099 ? number(value, ".0%") : value >= 0.00099 ? number(value, ".1%")
    : number(value, ".2%");
}

/* Another shape for each series: colour is not the only sign. */
const MARKS = [
  "M-4.5 0a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0 -9 0Z", "M-4 -4H4V4H-4Z", "M0 -5.5L5 4H-5Z", "M0 -6L5 0L0 6L-5 0Z",
  "M-5 -1.5H-1.5V-5H1.5V-1.5H5V1.5H1.5V5H-1.5V1.5H-5Z",
];
