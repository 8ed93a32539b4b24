// The class's table: sorted by a column, filtered by mistake, verdict and name. Without this script
// every row is there, in the order of the names.
(() => {
  "use strict";
  const table = document.getElementById("class"), filters = document.getElementById("filters");
  const state = document.getElementById("state");
  const heads = [...table.tHead.rows[0].cells];
  const collator = new Intl.Collator(undefined, { numeric: true, sensitivity: "base" });
  const plain = (text) => text.normalize("NFKD").replace(/\p{M}/gu, "").toLowerCase();
  const rows = [...table.tBodies].map((body) => ({
    body,
    name: plain(body.querySelector("th bdi").textContent),
    verdict: body.dataset.verdict,
    mistakes: body.dataset.mistakes.split(" "),
    keys: [...body.rows[0].cells].map((cell) => cell.dataset.key),
  }));
  let sorted = "";

  function filter() {
    const text = plain(filters.text.value.trim());
    const { value: verdict } = filters.verdict, { value: mistake } = filters.mistake;
    let shown = 0;
    for (const row of rows) {
      const keep = row.name.includes(text) && (!verdict || row.verdict === verdict)
        && (!mistake || row.mistakes.includes(mistake));
      row.body.hidden = !keep;
      shown += keep;
    }
    for (const button of document.querySelectorAll("[aria-pressed]")) {
      const { verdict: ofVerdict, mistake: ofMistake } = button.dataset;
      button.setAttribute("aria-pressed", ofVerdict ? ofVerdict === verdict : ofMistake === mistake);
    }
    tell(shown);
  }

  function tell(shown) {
    const chosen = [filters.verdict, filters.mistake].filter((s) => s.value).map((s) => s.selectedOptions[0].text);
    const text = filters.text.value.trim();
    if (text) chosen.push(say("name with “{text}”", { text }));
    const counted = rows.length === 1 ? say("{shown} of 1 submission", { shown })
      : say("{shown} of {count} submissions", { shown, count: rows.length });
    const which = chosen.join(say("; "));
    state.textContent = (which ? say("{counted}: {which}", { counted, which }) : counted) + sorted;
  }

  // What has no key comes last, whichever the direction.
  function sort(column) {
    const head = heads[column], numeric = "numeric" in head.dataset;
    const descending = head.getAttribute("aria-sort") === "ascending";
    const sign = descending ? -1 : 1;
    rows.sort(({ keys: { [column]: a } }, { keys: { [column]: b } }) =>
      !a || !b ? !a - !b : sign * (numeric ? a - b : collator.compare(a, b)));
    table.append(...rows.map((row) => row.body));
    for (const other of heads) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", descending ? "descending" : "ascending");
    const by = { name: head.textContent.trim() };
    sorted = descending ? say(", by {name}, descending", by) : say(", by {name}, ascending", by);
    tell(rows.filter((row) => !row.body.hidden).length);
  }

  // A row that a link leads to is shown, and opened.
  function reveal() {
    const body = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!rows.some((row) => row.body === body)) return;
    if (body.hidden) {
      filters.reset();
      filter();
    }
    body.querySelector("details").open = true;
    body.scrollIntoView();
  }

  heads.forEach((head, column) => {
    const button = head.firstElementChild;
    button.disabled = false;
    button.addEventListener("click", () => sort(column));
  });
  for (const button of document.querySelectorAll("[aria-pressed]")) {
    const { verdict, mistake } = button.dataset;
    const select = verdict ? filters.verdict : filters.mistake;
    button.disabled = false;
    button.addEventListener("click", () => {
      const pressed = button.getAttribute("aria-pressed") === "true";
      select.value = pressed ? "" : verdict ?? mistake;
      filter();
    });
  }
  filters.hidden = false;
  document.getElementById("unscripted").remove();
  filters.addEventListener("input", filter);
  filters.addEventListener("submit", (event) => event.preventDefault());
  filters.addEventListener("reset", () => setTimeout(filter));
  addEventListener("hashchange", reveal);
  filter();
  reveal();
})();
