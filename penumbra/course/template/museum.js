/* The museum of mistakes: one live renderer, which moves to the exhibit that was opened last, and
   the filter. Nothing is rendered while it cannot be seen, or nothing has changed. */

{
  const SIZE = { width: 300, height: 200 }, VISIBLE_SAMPLES = 64, FEWEST_PIXELS = 80;
  const MOST_SAMPLES = 64; // of a pixel: more are slow on a phone, and no mistake needs them
  const RESTS = 200; // [ms] without a change, then the picture is measured
  const { scenes, exhibits } = JSON.parse(document.getElementById("museum-data").textContent);
  const museum = document.getElementById("museum");
  const live = document.getElementById("museum-live");
  const part = (name) => document.getElementById(`museum-${name}`);
  const SCENES = {
    tp3_statement: () => say("the lab’s scene"),
    tp3_sheared: () => say("a sheared quad"),
    tp3_two_quads: () => say("two quads"),
    check_low: () => say("a large, low light"),
  };

  /* ---- the filter ---- */

  const cards = [...museum.querySelectorAll(".exhibit")];
  const groups = [...museum.querySelectorAll(".group")];

  function filter() {
    const wanted = plain(part("search").value), group = part("group").value, seen = part("seen").checked;
    let count = 0;
    for (const card of cards) {
      const said = plain(`${card.textContent} ${card.dataset.name}`);
      card.hidden = !(said.includes(wanted) && (!seen || Number(card.dataset.seen) > 0)
        && (!group || card.closest(".group").dataset.group === group));
      count += !card.hidden;
    }
    for (const each of groups) each.hidden = !each.querySelector(".exhibit:not([hidden])");
    part("found").textContent = say("{count} of {all} mistakes", { count, all: cards.length });
  }

  function plain(text) {
    return text.normalize("NFD").replace(/\p{M}/gu, "").replace(/\s+/g, " ").trim().toLowerCase();
  }

  /* Options of a select, of [value, text], of which the chosen one stays. */
  function fill(select, options, chosen = select.value) {
    select.replaceChildren(...options.map(([value, text]) => new Option(text, value)));
    select.value = chosen;
  }

  function speakAnew() {
    const headings = groups.map((g) => [g.dataset.group, g.querySelector(`h3 [lang="${language()}"]`).textContent]);
    fill(part("group"), [["", say("all")], ...headings]);
    fill(part("scene"), Object.entries(SCENES).map(([name, text]) => [name, text()]));
    filter();
    describe();
    write();
  }

  for (const name of ["search", "group", "seen"]) part(name).addEventListener("input", filter);
  part("filter").addEventListener("submit", (event) => event.preventDefault());
  part("filter").hidden = part("found").hidden = false;

  /* ---- a link opens its exhibit ---- */

  function openLinked() {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    const card = target && target.closest(".exhibit");
    if (!card) return;
    if (card.hidden) {
      part("filter").reset();
      filter();
    }
    card.open = true;
    card.querySelector("summary").focus({ preventScroll: true });
    stayAt(card);
  }
  addEventListener("hashchange", openLinked);

  /* Figures above become live, and taller, after the page has opened: follow, until the reader moves. */
  function stayAt(card) {
    const follow = new ResizeObserver(() => card.scrollIntoView({ block: "start", behavior: "instant" }));
    follow.observe(document.body);
    const input = ["wheel", "touchstart", "pointerdown", "keydown"];
    const end = () => {
      follow.disconnect();
      for (const kind of input) removeEventListener(kind, end);
    };
    for (const kind of input) addEventListener(kind, end, { passive: true });
    setTimeout(end, 5000);
  }

  /* ---- the live renderer ---- */

  let core = null, card = null, visible = false, stale = false, busy = false, resting = 0, seed = 1;
  let measured = null; // of the state that is shown
  const right = new Map(); // what does not depend on the mistake, by scene and counts

  function state() {
    const exhibit = exhibits[card.dataset.name];
    const [module, form] = exhibit.forms[Number(part("form").value)];
    return {
      scene: part("scene").value, module, form, m: exhibit.m, n: 1 << Number(part("n").value),
      shows: !part("mistake").checked ? "right" : part("half").checked ? "half" : "mistake",
    };
  }

  /* Into an exhibit, with its own scene and counts. */
  function enter(next) {
    card = next;
    const exhibit = exhibits[card.dataset.name];
    const codes = [...card.querySelectorAll(".forms tbody code")].map((code) => code.textContent);
    fill(part("form"), exhibit.forms.map(([, name], i) => [i, codes[i] || name]), exhibit.chosen);
    part("form-label").hidden = exhibit.forms.length < 2;
    part("scene").value = exhibit.scene;
    part("n").max = Math.log2(MOST_SAMPLES / exhibit.m);
    part("n").value = Math.log2(exhibit.n);
    part("mistake").checked = true;
    part("half").checked = false;
    hideMeasured();
    card.querySelector("figure").prepend(live);
    live.hidden = false;
    change();
  }

  function leave() {
    hideMeasured();
    museum.append(live);
    live.hidden = true;
    card = null;
  }

  function hideMeasured() {
    for (const cell of museum.querySelectorAll(".now:not([hidden])")) cell.hidden = true;
  }

  function change() {
    stale = true;
    measured = null;
    clearTimeout(resting);
    describe();
    wake();
  }

  function describe() {
    const { n } = card ? state() : { n: 1 };
    part("n-shown").textContent = n;
    if (!card) return;
    const { shows } = state();
    live.dataset.shows = shows;
    const title = card.querySelector(`.title [lang="${language()}"]`).textContent;
    part("canvas").setAttribute("aria-label",
      shows === "right" ? say("The right picture, with N = {n}", { n })
        : shows === "half" ? say("Left half with the mistake, right half without, with N = {n}", { n })
          : say("Rendered with the mistake “{title}”, with N = {n}", { title, n }));
  }

  function wake() {
    if (!core || !card || !visible || !stale || busy) return;
    requestAnimationFrame(draw);
  }

  async function draw() {
    if (!card || !stale || busy) return;
    busy = true;
    stale = false;
    const now = state();
    try {
      const wrong = now.shows === "right" ? null : await frame(now, seed, choices(now));
      const good = now.shows === "mistake" ? null : await frame(now, seed, {});
      paint(part("canvas"), wrong && good ? halves(wrong, good) : wrong || good);
      live.dataset.frames = Number(live.dataset.frames || 0) + 1;
      if (!stale) resting = setTimeout(measure, RESTS, now);
    } finally {
      busy = false;
    }
    wake();
  }

  function choices({ module, form }) {
    return { [module]: form };
  }

  async function frame({ scene, n, m }, seed, made) {
    const place = m > 1 ? { position_x: -1, position_y: -1 } : {};
    const found = await core.mistaken(scenes[scene], made,
      { ...SIZE, nb_light_samples: n, samples_per_pixel: m, seed, ...place });
    if (made.output === "wrap") { // what is not cut at 1 before it becomes 8 bits
      for (let i = 0; i < found.radiance.length; i++) found.radiance[i] %= 256 / 255;
    }
    return found;
  }

  function halves(left, other) {
    const { width } = left, radiance = left.radiance.slice();
    for (let i = 0; i < radiance.length; i++) if (i % width >= width / 2) radiance[i] = other.radiance[i];
    return { ...left, radiance };
  }

  /* ---- what is measured: two pictures with the mistake against two without, of the same random
     numbers, which is what museum.py does ---- */

  async function measure(now) {
    if (!card || stale) return;
    const key = JSON.stringify([now.scene, now.n, now.m, seed]);
    if (!right.has(key)) {
      right.clear();
      right.set(key, (async () => ({
        parts: await parts(now.scene),
        frames: [await frame(now, seed, {}), await frame(now, seed + 1, {})],
      }))());
    }
    const { parts: masks, frames } = await right.get(key);
    const made = now.shows === "right" ? {} : choices(now);
    const found = now.shows === "right" ? frames : [await frame(now, seed, made), await frame(now, seed + 1, made)];
    if (!card || stale || JSON.stringify(now) !== JSON.stringify(state())) return;
    const cut = made.clamp || made.output === "wrap";
    measured = numbers(found.map((f) => sums(f, cut)), frames.map((f) => sums(f, cut)), masks, now.n * now.m);
    write();
  }

  /* Which pixels are lit floor, lit sphere, penumbra, shadow: of the same samples, with shadow rays
     and without, of a scene with blue spheres and red planes. */
  async function parts(name) {
    const coloured = (things, color) => (things || []).map((thing) => ({ ...thing, color }));
    const scene = {
      ...scenes[name], background: [0, 0, 0],
      spheres: coloured(scenes[name].spheres, [0, 0, 1]), planes: coloured(scenes[name].planes, [1, 0, 0]),
    };
    const settings = { ...SIZE, nb_light_samples: VISIBLE_SAMPLES, seed: 0 };
    const [seen, there] = await Promise.all(
      ["std", "none"].map((ray) => core.mistaken(scene, { visibility: ray }, settings)));
    const pixels = SIZE.width * SIZE.height, [a, b] = [sums(seen), sums(there)];
    const masks = { floor: [], sphere: [], penumbra: [], shadow: [] };
    for (let i = 0; i < pixels; i++) {
      if (b[i] <= 0) continue;
      const kind = a[i] === 0 ? "shadow" : a[i] !== b[i] ? "penumbra" : there.radiance[i] > 0 ? "floor" : "sphere";
      masks[kind].push(i);
    }
    return masks;
  }

  /* The sum of the colours, pixel by pixel; cut: at 1. */
  function sums({ radiance, width, height }, cut = false) {
    const pixels = width * height, sum = new Float64Array(pixels);
    for (let c = 0; c < 3; c++) for (let i = 0; i < pixels; i++) sum[i] += radiance[c * pixels + i];
    return cut ? sum.map((value) => Math.min(Math.max(value, 0), 1)) : sum;
  }

  function numbers(found, usual, masks, samples) {
    const total = (pictures, mask) => pictures.reduce((sum, p) => sum + mask.reduce((s, i) => s + p[i], 0), 0);
    const variance = ([a, b], mask) => mask.reduce((sum, i) => sum + (a[i] - b[i]) ** 2, 0);
    const ratio = (mask) => mask.length < FEWEST_PIXELS ? null : total(found, mask) / total(usual, mask);
    const penumbra = ratio(masks.penumbra), noise = variance(found, masks.penumbra);
    const effective = samples * penumbra ** 2 * variance(usual, masks.penumbra) / noise;
    const saved = found.map((p) => p.map((value) => Math.min(Math.max(value, 0), 1)));
    return {
      floor: ratio(masks.floor), sphere: ratio(masks.sphere), penumbra,
      shadow: masks.shadow.length ? total(saved, masks.shadow) / masks.shadow.length / saved.length : 0,
      effective: penumbra > 0 && effective < 100 * samples ? effective : null,
    };
  }

  function write() {
    if (!card || !measured) return;
    const { floor, sphere, penumbra, shadow, effective } = measured;
    const times = (ratio) => ratio === null ? "–"
      : ratio >= 0.1 && ratio < 10 ? say("× {ratio:.2f}", { ratio }) : say("× {ratio:.2g}", { ratio });
    const cells = [times(floor), times(sphere), times(penumbra), say("{value:.0f} of 255", { value: 255 * shadow }),
      effective === null ? say("none") : say("{n:.2g}", { n: Math.max(effective, 0.1) })];
    const head = state().shows === "right" ? say("now, without it") : say("now");
    card.querySelectorAll(".now").forEach((cell, i) => {
      cell.textContent = [head, ...cells][i];
      cell.hidden = false;
    });
    live.dataset.measured = Number(live.dataset.measured || 0) + 1;
  }

  for (const name of ["mistake", "half", "form", "n", "scene"]) part(name).addEventListener("input", change);
  part("again").addEventListener("click", () => {
    seed += 2;
    change();
  });
  document.addEventListener("penumbra:language", speakAnew);
  speakAnew();

  coreReady.then((ready) => {
    core = ready;
    museum.classList.add("alive");
    for (const each of cards) {
      each.addEventListener("toggle", () => {
        if (each.open) enter(each);
        else if (each === card) leave();
      });
      if (each.open) enter(each);
    }
    new IntersectionObserver((entries) => {
      visible = entries.at(-1).isIntersecting;
      wake();
    }).observe(live);
  }, () => {});
  openLinked();
}
