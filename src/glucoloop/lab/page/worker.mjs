// @ts-check
/** A worker: it is given the module and the data of the page once, then simulates the people it is asked for. Until then it draws them. */

import { load } from "../../native/targets/wasm/kernels.mjs";
import { Lab } from "./lab.mjs";
import { some } from "./many.mjs";
import { peopleOf } from "./people.mjs";
import { usual } from "./situation.mjs";

/**
 * Draw people around the usual patient who may be asked for, one turn after another, so that the worker answers in between.
 * @param {Lab} lab
 * @param {{size: number, turns: number[]}} expected
 */
function draw(lab, { size, turns }) {
  const [first, ...others] = turns;
  if (first === undefined) return;
  const people = peopleOf(lab, usual(lab.data).patient);
  for (let person = first; person < first + size; person += lab.kernels.lanes) people.from(person);
  setTimeout(() => draw(lab, { size, turns: others }));
}

export function start() {
  /** @type {Lab | undefined} */
  let lab;
  globalThis.onmessage = async (/** @type {MessageEvent} */ { data: asked }) => {
    if (lab === undefined) {
      const made = new Lab(await load(asked.module, "float64"), asked.data);
      lab = made;
      setTimeout(() => draw(made, asked.expected));
      return globalThis.postMessage("ready");
    }
    const part = some(lab, asked.situation, asked.first, asked.count);
    globalThis.postMessage(part, { transfer: [part.glucose.buffer] });
  };
}
