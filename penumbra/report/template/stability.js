// The stability map: a cell a scene, coloured by its rounding error. No library, no network.
// Its words are said by words.js.
"use strict";

(() => {
  const root = document.getElementById("stability-map");
  const { cells, limits } = JSON.parse(document.getElementById("stability-data").textContent);
  const $ = (name) => root.querySelector(`[data-part="${name}"]`);
  const plot = $("plot");
  const WIDTH = 660, LEFT = 62, RIGHT = 8, TOP = 30, BOTTOM = 384;
  const numbers = (key) => [...new Set(cells.map((c) => c[key]))].sort((a, b) => a - b);
  const ratios = numbers("ratio"), moves = numbers("translation");
  const w = (WIDTH - LEFT - RIGHT) / ratios.length, h = (BOTTOM - TOP) / moves.length;
  const state = { precision: "float32", x: Math.floor(ratios.length / 2), y: 0 };
  const at = (x, y) =>
    cells.find((c) => c.ratio === ratios[x] && c.translation === moves[y]);

  const superscript = (n) => [...String(n)].map((c) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[c] ?? "⁻").join("");
  const power = (value) => value === 0 ? "0" : value === 1 ? "1"
    : "10" + superscript(Math.round(Math.log10(value)));
  const errorText = (value) => value === 0 ? "0"
    : localised(value.toExponential(1)).replace(/e\+?(.*)/, (_, n) => " × 10" + superscript(n));

  function element(name, attributes, text) {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    plot.append(made);
    return made;
  }

  // From 1e-16 (white) to 1 (dark red), a step a decade, by lightness: told apart in grey too.
  function colour(error) {
    const share = Math.min(1, Math.max(0, (Math.log10(Math.max(error, 1e-16)) + 16) / 16));
    return `hsl(${45 - 45 * share} 85% ${97 - 62 * share}%)`;
  }

  const passed = (cell) => limits.filter((limit) => cell[state.precision] > limit).length;

  function draw() {
    plot.replaceChildren();
    ratios.forEach((ratio, x) => moves.forEach((move, y) => {
      const cell = at(x, y), error = cell[state.precision];
      const left = LEFT + x * w, top = BOTTOM - (y + 1) * h;
      element("rect", { class: "cell", x: left, y: top, width: w - 1, height: h - 1, fill: colour(error) });
      const dark = error > 1e-5;
      element("text", { x: left + w / 2, y: top + h / 2 + 4, "text-anchor": "middle", style: `fill:${dark ? "#fff" : "#333"};font-size:10px` },
              error === 0 ? "0" : error.toExponential(0));
      if (x + 1 < ratios.length && passed(at(x + 1, y)) !== passed(cell))
        element("line", { class: "boundary", x1: left + w, x2: left + w, y1: top, y2: top + h });
      if (y + 1 < moves.length && passed(at(x, y + 1)) !== passed(cell))
        element("line", { class: "boundary", x1: left, x2: left + w, y1: top, y2: top });
    }));
    ratios.forEach((r, x) => element("text", { x: LEFT + (x + 0.5) * w, y: BOTTOM + 17, "text-anchor": "middle" }, power(r)));
    moves.forEach((m, y) => element("text", { x: LEFT - 7, y: BOTTOM - (y + 0.5) * h + 4, "text-anchor": "end" }, power(m)));
    element("text", { x: (LEFT + WIDTH) / 2, y: BOTTOM + 38, "text-anchor": "middle" }, say("side of the light over its distance"));
    element("text", { transform: `translate(12 ${(TOP + BOTTOM) / 2}) rotate(-90)`, "text-anchor": "middle" }, say("translation [m]"));
    element("rect", { class: "chosen", x: LEFT + state.x * w, y: BOTTOM - (state.y + 1) * h, width: w - 1, height: h - 1 });
    tell();
  }

  function tell() {
    const cell = at(state.x, state.y);
    const rows = [
      [say("side / distance"), power(cell.ratio)],
      [say("translation"), `${power(cell.translation)} m`],
      ["float32", errorText(cell.float32)],
      ["float64", errorText(cell.float64)],
    ];
    $("readout").replaceChildren(...rows.flatMap(([term, value]) => {
      const dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.textContent = term;
      dd.textContent = value;
      return [dt, dd];
    }));
    $("spoken").textContent = rows.map((row) => row.join(" ")).join(", ");
  }

  function choose(x, y) {
    state.x = Math.min(ratios.length - 1, Math.max(0, x));
    state.y = Math.min(moves.length - 1, Math.max(0, y));
    draw();
  }

  plot.addEventListener("pointermove", (event) => {
    const box = plot.getBoundingClientRect(), scale = WIDTH / box.width;
    const x = Math.floor(((event.clientX - box.left) * scale - LEFT) / w);
    const y = Math.floor((BOTTOM - (event.clientY - box.top) * scale) / h);
    if (x >= 0 && y >= 0 && x < ratios.length && y < moves.length && (x !== state.x || y !== state.y))
      choose(x, y);
  });
  plot.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!step) return;
    event.preventDefault();
    choose(state.x + step[0], state.y + step[1]);
  });
  $("precision").addEventListener("change", (event) => {
    state.precision = event.target.value;
    draw();
  });
  root.hidden = false;
  draw();
})();
