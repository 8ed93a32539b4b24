// Words and numbers of the other scripts, in the page's language. WORDS: their texts, translated.
const french = document.documentElement.lang === "fr";

// A number as the language writes it.
const localised = (number) => (french
  ? String(number).replace(".", ",").replace(/\s?%/, "\u00a0%") : String(number));

// The text in the page's language, each {name} of it filled.
const say = (text, values = {}) =>
  (WORDS[text] ?? text).replace(/\{(\w+)\}/g, (whole, name) => String(values[name] ?? whole));
