/* The language that the reader is spoken to in. Texts of the templates are in the page in both, and
   CSS shows one; what scripts say goes through say(), as in penumbra/language.py. */

const MESSAGES = JSON.parse(document.getElementById("messages").textContent);  // English -> French
const NO_BREAK = "\u00a0";
const SWITCH = { en: document.getElementById("language-en"), fr: document.getElementById("language-fr") };

function language() {
  return SWITCH.fr.checked ? "fr" : "en";
}

/* The text in the language that is spoken now, its {name:format} filled as Python would. */
function say(text, values = {}) {
  const said = language() === "fr" ? MESSAGES[text] || text : text;
  return said.replace(/\{\{|\}\}|\{(\w+)(?::([^}]*))?\}/g, (all, name, format) => {
    if (name === undefined) return all[0];
    if (!(name in values)) throw new Error(`no value for {${name}} in: ${text}`);
    const value = values[name];
    return typeof value === "number" ? localised(formatted(value, format || "")) : String(value);
  });
}

/* A number alone, as the language that is spoken now writes it. */
function number(value, format) {
  return localised(formatted(value, format));
}

function unit(value, format, name) {
  return number(value, format) + NO_BREAK + name;
}

/* As Python's format(value, format), for the formats [+][,][.digits][f|e|g|%|d] and none. */
function formatted(value, format) {
  const [, plus, commas, digits, kind] = /^(\+?)(,?)(?:\.(\d+))?([feg%d]?)$/.exec(format) || bad(format);
  if (!Number.isFinite(value)) return Number.isNaN(value) ? "nan" : value > 0 ? "inf" : "-inf";
  const places = digits === undefined ? 6 : Number(digits);
  let text = kind === "f" ? value.toFixed(places)
    : kind === "%" ? (100 * value).toFixed(places) + "%"
    : kind === "e" ? scientific(value.toExponential(places))
    : kind === "g" ? general(value, places || 1)
    : String(value);
  if (commas) text = text.replace(/^-?\d+/, (whole) => whole.replace(/\B(?=(\d{3})+$)/g, ","));
  return (plus && value >= 0 ? "+" : "") + text;
}

function bad(format) {
  throw new Error(`unknown format: ${format}`);
}

function general(value, digits) {
  const rounded = value.toExponential(digits - 1), exponent = Number(rounded.split("e")[1]);
  const plain = exponent >= -4 && exponent < digits;
  const text = plain ? value.toFixed(digits - 1 - exponent) : rounded;
  const [mantissa, power] = text.split("e");
  const short = mantissa.includes(".") ? mantissa.replace(/\.?0+$/, "") : mantissa;
  return plain ? short : scientific(`${short}e${power}`);
}

function scientific(text) {
  return text.replace(/e([+-])(\d)$/, "e$10$2");
}

function localised(number) {
  if (language() !== "fr") return number;
  return number.replace(/,/g, NO_BREAK).replace(".", ",").replace("%", NO_BREAK + "%");
}

/* Writes what `text` says into the element (or its attribute), now and in each language to come. */
function spoken(element, text, attribute = null) {
  const write = () => attribute ? element.setAttribute(attribute, text()) : element.replaceChildren(text());
  write();
  document.addEventListener("penumbra:language", write);
  return element;
}

/* Where the reader is: a function that brings the same words, or picture, back to where they were.
   Until then the browser's own way of keeping the place must not move the page too. */
function readersPlace() {
  const root = document.documentElement, height = window.innerHeight / 3;
  const at = document.elementFromPoint(window.innerWidth / 2, height);
  const text = at && at.closest("main [lang]");
  const twin = text && [...text.parentElement.children].find((e) => e.lang && e.lang !== text.lang);
  const block = twin ? text : at && at.closest("main section, main figure, main details, main");
  if (!block) return () => {};
  const before = block.getBoundingClientRect();
  const share = twin ? (height - before.top) / (before.height || 1) : 0;
  root.style.overflowAnchor = "none";
  return () => {
    const now = (twin || block).getBoundingClientRect();
    const goal = twin ? height - share * now.height : before.top;
    window.scrollBy({ top: now.top - goal, behavior: "instant" });
    requestAnimationFrame(() => { root.style.overflowAnchor = ""; });
  };
}

function speak(chosen) {
  SWITCH[chosen].checked = true;
  document.documentElement.lang = chosen;
  for (const element of document.querySelectorAll("[data-label]")) {
    const label = element.dataset.label;
    element.setAttribute(element.tagName === "IMG" ? "alt" : "aria-label", chosen === "fr" ? MESSAGES[label] || label : label);
  }
  for (const element of document.querySelectorAll("[data-alt-en]")) {
    element.alt = chosen === "fr" ? element.dataset.altFr : element.dataset.altEn;
  }
  document.dispatchEvent(new CustomEvent("penumbra:language", { detail: chosen }));
}

{
  const known = (chosen) => (chosen in SWITCH ? chosen : null);
  let remembered = null;
  try {
    remembered = localStorage.getItem("penumbra-language");
  } catch { /* a browser may refuse: then the choice lasts as long as the page */ }
  const asked = new URLSearchParams(location.search).get("lang");
  speak(known(asked) || known(remembered) || (navigator.language.startsWith("fr") ? "fr" : "en"));

  let restore = null;
  for (const [chosen, input] of Object.entries(SWITCH)) {
    for (const label of input.labels) {
      label.addEventListener("click", () => { restore = readersPlace(); });
    }
    input.addEventListener("keydown", () => { restore = readersPlace(); });
    input.addEventListener("change", () => {
      speak(chosen);
      if (restore) restore();
      restore = null;
      try {
        localStorage.setItem("penumbra-language", chosen);
      } catch { /* as above */ }
    });
  }
}
