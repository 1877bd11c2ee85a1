// @ts-check
/** Elements of the page, made and found. */

import { texts } from "./texts.mjs";

export const byId = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));
export const button = (/** @type {string} */ id) => /** @type {HTMLButtonElement} */ (byId(id));
export const input = (/** @type {string} */ id) => /** @type {HTMLInputElement} */ (byId(id));
export const select = (/** @type {string} */ id) => /** @type {HTMLSelectElement} */ (byId(id));

/**
 * @template {keyof HTMLElementTagNameMap} Tag
 * @param {Tag} tag
 * @param {Record<string, string>} attributes
 * @param {(Node | string)[]} content
 * @returns {HTMLElementTagNameMap[Tag]}
 */
export function element(tag, attributes = {}, ...content) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...content);
  return made;
}

/** A text whose symbols have their subscripts: of "Γ_y" the y. @param {string} text */
function symbols(text) {
  return text.split(/_([a-z])\b/).map((part, i) => (i % 2 ? element("sub", {}, part) : part));
}

/**
 * Put choices into a list.
 * @param {HTMLSelectElement} list
 * @param {[string, string][]} choices value and text of each
 */
export function choices(list, choices) {
  list.replaceChildren(...choices.map(([value, text]) => element("option", { value }, text)));
}

/** Put a text where it is not there yet; to put it there again would make the browser lay out the page. @param {Element} place @param {string} text */
export function tell(place, text) {
  if (place.textContent !== text) place.textContent = text;
}

/** Give an element an attribute that it has not yet. @param {Element} of @param {string} name @param {string} value */
export function attribute(of, name, value) {
  if (of.getAttribute(name) !== value) of.setAttribute(name, value);
}

/** Say a sentence above the picture, which screen readers read out. @param {string} text @param {boolean} [refused] */
export function say(text, refused = false) {
  const said = byId("said");
  tell(said, text);
  said.classList.toggle("refused", refused);
}

/**
 * A slider with a field for its number.
 * @param {string} id
 * @param {string} summary what is set, as a sentence
 * @param {{least: number, most: number, step: number}} range
 * @param {number} value
 * @param {(value: number) => void} changed
 */
export function slider(id, summary, { least, most, step }, value, changed) {
  const label = summary.replace(/\.$/, "");
  const bounds = { min: `${least}`, max: `${most}`, value: `${value}` };
  const range = element("input", { ...bounds, type: "range", id, step: `${step}` });
  const number = element("input", { ...bounds, type: "number", step: "any", "aria-label": texts.numberOf(label) });
  range.addEventListener("input", () => {
    number.value = range.value;
    changed(Number(range.value));
  });
  number.addEventListener("change", () => {
    range.value = number.value;
    changed(Number(number.value));
  });
  return element("div", { class: "slider" }, element("label", { for: id }, ...symbols(label)), range, number);
}

/** Show a value on a slider, but not in the field that has the focus. @param {Element} box @param {number} value */
export function setSlider(box, value) {
  for (const field of box.querySelectorAll("input")) {
    if (field !== document.activeElement && field.value !== `${value}`) field.value = `${value}`;
  }
}

/** Put the page's own texts into the elements that name them. */
export function fillTexts() {
  for (const place of document.querySelectorAll("[data-text]")) {
    place.textContent = texts.page[/** @type {keyof typeof texts.page} */ (place.getAttribute("data-text"))];
  }
  for (const place of document.querySelectorAll("[data-label]")) {
    const name = /** @type {keyof typeof texts.page} */ (place.getAttribute("data-label"));
    place.setAttribute("aria-label", texts.page[name]);
  }
}
