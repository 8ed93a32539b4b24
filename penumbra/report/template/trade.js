// Error against time: draws the chart of #trade-data and tells what is under the pointer or the
// keys. No library, no network. Its words are said by words.js.
"use strict";

(() => {
  const root = document.getElementById("trade-plot");
  const data = JSON.parse(document.getElementById("trade-data").textContent);
  const $ = (name) => root.querySelector(`[data-part="${name}"]`);
  const plot = $("plot");
  const WIDTH = 660, HEIGHT = 460, LEFT = 72, RIGHT = 14, TOP = 12, BOTTOM = 44;
  const NEAR = 30;  // [px of the drawing] a pointer farther from every mark chooses none

  const state = {
    region: data.regions.some((r) => r.name === "penumbra") ? "penumbra" : data.regions[0].name,
    threads: Math.max(...data.threads),
    hidden: new Set(),  // indices of series
    chosen: null,       // a point
  };

  function element(name, attributes, parent, text) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    if (parent) parent.append(made);
    return made;
  }

  // ---- what is shown ---------------------------------------------------------------------

  const here = () => data.points.filter(
    (p) => p.region === state.region && (p.threads ?? state.threads) === state.threads && p.y > 0);
  const shown = () => here().filter((p) => !state.hidden.has(p.series));
  const along = (points, series) =>
    points.filter((p) => p.series === series).sort((a, b) => (a.n || 0) - (b.n || 0));
  const most = Math.max(...data.threads);
  const frontier = () => here().filter((p) => p.frontier && (p.threads ?? most) === state.threads).sort((a, b) => a.x - b.x);

  // ---- scales: logarithmic, over all regions, so that one looks like another ----------------

  function range(values, extra) {
    const logs = values.filter((v) => v > 0).map(Math.log10);
    return [Math.min(...logs) - extra, Math.max(...logs) + extra];
  }
  const [x0, x1] = range(data.points.map((p) => p.x), 0.1);
  const [y0, y1] = range(
    [...data.points.map((p) => p.y), ...data.targets.map((t) => t.y)].filter((y) => y > 0), 0.1);
  const px = (x) => LEFT + (Math.log10(x) - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT);
  const py = (y) => HEIGHT - BOTTOM - (Math.log10(y) - y0) / (y1 - y0) * (HEIGHT - TOP - BOTTOM);

  const decades = (low, high) =>
    Array.from({ length: Math.floor(high) - Math.ceil(low) + 1 }, (_, i) => Math.ceil(low) + i);
  const timeText = (power) =>
    localised(power >= 0 ? `${10 ** power} s` : power >= -3 ? `${10 ** (power + 3)} ms`
                                                            : `${10 ** (power + 6)} µs`);
  const superscript = (n) => [...String(n)].map((c) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[c] ?? "⁻").join("");
  const errorText = (power) =>
    localised(power >= -5 ? `${+(10 ** (power + 2)).toPrecision(1)}%`
                          : `10${superscript(power + 2)}%`);

  // ---- drawing ---------------------------------------------------------------------------

  const SHAPES = {
    circle: "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0Z",
    square: "M-3.7 -3.7H3.7V3.7H-3.7Z",
    triangle: "M0 -5L4.6 3.4H-4.6Z",
    diamond: "M0 -5.2L4.4 0L0 5.2L-4.4 0Z",
    star: "M0 -6.5L1.9 -2H6.3L2.8 1.2L4 6L0 3.2L-4 6L-2.8 1.2L-6.3 -2H-1.9Z",
  };

  function drawAxes() {
    for (const power of decades(x0, x1)) {
      const x = px(10 ** power);
      element("line", { class: "gridline", x1: x, x2: x, y1: TOP, y2: HEIGHT - BOTTOM }, plot);
      element("text", { x, y: HEIGHT - BOTTOM + 17, "text-anchor": "middle" }, plot,
              timeText(power));
    }
    for (const power of decades(y0, y1)) {
      const y = py(10 ** power);
      element("line", { class: "gridline", x1: LEFT, x2: WIDTH - RIGHT, y1: y, y2: y }, plot);
      element("text", { x: LEFT - 7, y: y + 4, "text-anchor": "end" }, plot, errorText(power));
    }
    for (const target of data.targets) {
      const y = py(target.y);
      element("line", { class: "target", x1: LEFT, x2: WIDTH - RIGHT, y1: y, y2: y }, plot);
      element("text", { x: WIDTH - RIGHT, y: y - 4, "text-anchor": "end" }, plot, target.text);
    }
    element("path", { class: "axis-line", fill: "none",
                      d: `M${LEFT} ${TOP}V${HEIGHT - BOTTOM}H${WIDTH - RIGHT}` }, plot);
    element("text", { x: (LEFT + WIDTH) / 2, y: HEIGHT - 6, "text-anchor": "middle" }, plot,
            say("time of a frame"));
    element("text", { transform: `translate(12 ${(TOP + HEIGHT - BOTTOM) / 2}) rotate(-90)`,
                      "text-anchor": "middle" }, plot, say("relative error"));
  }

  const line = (points) => "M" + points.map((p) => `${px(p.x)} ${py(p.y)}`).join("L");

  function drawMark(point) {
    const series = data.series[point.series];
    element("path", {
      class: point.frontier ? "mark on-frontier" : "mark", d: SHAPES[series.shape],
      fill: series.colour, transform: `translate(${px(point.x)} ${py(point.y)})`,
    }, plot);
  }

  function draw() {
    plot.replaceChildren();
    drawAxes();
    const best = frontier();
    if (best.length) element("path", { class: "frontier", d: line(best) }, plot);
    const points = shown();
    data.series.forEach((series, i) => {
      const curve = along(points, i);
      if (curve.length > 1)
        element("path", { class: "curve", d: line(curve), stroke: series.colour }, plot);
    });
    points.filter((p) => !p.frontier).forEach(drawMark);
    points.filter((p) => p.frontier).forEach(drawMark);
    if (state.chosen)
      element("circle", { class: "ring", r: 9, cx: px(state.chosen.x), cy: py(state.chosen.y) },
              plot);
    tell();
  }

  // ---- the row under the pointer or the keys -----------------------------------------------

  function tell() {
    const p = state.chosen;
    const rows = !p ? [] : [
      [say("method"), data.series[p.series].label],
      ...(p.n ? [["N", String(p.n)]] : []),
      [say("time"), `${p.time} (${p.timeRange})`],
      [say("error"), `${p.error} (${p.errorRange})`],
      [say("efficiency"), `${p.efficiency} 1/s`],
      [say("frontier"), p.frontier ? say("yes: none is faster and nearer") : say("no")],
      [say("options"), p.options],
    ];
    $("readout").replaceChildren(...rows.flatMap(([term, text]) => {
      const dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.textContent = term;
      dd.textContent = text;
      return [dt, dd];
    }));
    const said = p && {
      method: `${data.series[p.series].label}${p.n ? `, N ${p.n}` : ""}`, error: p.error, time: p.time,
    };
    $("spoken").textContent = !p ? ""
      : p.frontier ? say("{method}: {error} in {time}, on the frontier", said)
      : say("{method}: {error} in {time}", said);
  }

  function choose(point) {
    if (point === state.chosen) return;
    state.chosen = point || null;
    draw();
  }

  // The same setting after another region or number of threads was selected, if it is there.
  function rechoose() {
    const p = state.chosen;
    state.chosen = p && shown().find((q) => q.series === p.series && q.n === p.n) || null;
    draw();
  }

  plot.addEventListener("pointermove", (event) => {
    const box = plot.getBoundingClientRect();
    const x = (event.clientX - box.left) * WIDTH / box.width;
    const y = (event.clientY - box.top) * HEIGHT / box.height;
    let nearest = null, least = NEAR;
    for (const p of shown()) {
      const distance = Math.hypot(px(p.x) - x, py(p.y) - y);
      if (distance < least) [nearest, least] = [p, distance];
    }
    if (nearest) choose(nearest);
  });

  function step(list, by) {
    const at = list.indexOf(state.chosen);
    return list[at < 0 ? 0 : Math.min(list.length - 1, Math.max(0, at + by))];
  }

  function otherSeries(by) {
    const points = shown();
    const present = [...new Set(points.map((p) => p.series))].sort((a, b) => a - b);
    const at = present.indexOf(state.chosen.series);
    const next = along(points, present[(at + by + present.length) % present.length]);
    const gap = (p) => Math.abs(Math.log(p.x / state.chosen.x));
    return next.reduce((a, b) => (gap(b) < gap(a) ? b : a));
  }

  plot.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const points = shown();
    if (!points.length) return;
    const best = frontier().filter((p) => !state.hidden.has(p.series));
    const start = best[0] || points[0];
    const own = state.chosen ? along(points, state.chosen.series) : [];
    const moves = {
      ArrowRight: () => step(own, 1), ArrowLeft: () => step(own, -1),
      Home: () => own[0], End: () => own.at(-1),
      ArrowUp: () => otherSeries(-1), ArrowDown: () => otherSeries(1),
      f: () => step(best, 1), F: () => step(best, -1),
    };
    const move = moves[event.key];
    if (!move) return;
    event.preventDefault();
    choose(state.chosen ? move() || state.chosen : start);
  });

  // ---- controls --------------------------------------------------------------------------

  function fill(select, options, value, change) {
    for (const [key, text] of options) select.add(new Option(text, key));
    select.value = value;
    select.addEventListener("change", () => { change(select.value); rechoose(); });
  }
  fill($("region"), data.regions.map((r) => [r.name, r.title]), state.region,
       (value) => { state.region = value; });
  fill($("threads"), data.threads.map((t) => [t, String(t)]), String(state.threads),
       (value) => { state.threads = +value; });

  data.series.forEach((series, i) => {
    const label = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox";
    box.checked = true;
    box.addEventListener("change", () => {
      state.hidden[box.checked ? "delete" : "add"](i);
      rechoose();
    });
    const icon = element("svg", { viewBox: "-8 -8 16 16", "aria-hidden": "true" });
    element("path", { d: SHAPES[series.shape], fill: series.colour }, icon);
    label.append(box, icon, series.label);
    $("legend").append(label);
  });

  root.hidden = false;
  draw();
})();
