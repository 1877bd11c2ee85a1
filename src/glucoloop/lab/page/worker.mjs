// @ts-check
/** A worker: it is given the module and the data of the page once, then simulates the people it is asked for. Until then it draws them. */

import { load } from "../../native/targets/wasm/kernels.mjs";
import { Lab } from "./loop.mjs";
import { some } from "./many.mjs";
import { peopleOf } from "./people.mjs";

/**
 * Draw people who may be asked for, one turn after another, so that the worker answers in between.
 * @param {Lab} lab
 * @param {ReturnType<typeof peopleOf>} people
 * @param {{size: number, turns: number[]}} expected
 */
function draw(lab, people, { size, turns }) {
  const [first, ...others] = turns;
  if (first === undefined) return;
  for (let person = first; person < first + size; person += lab.kernels.lanes) people(person);
  setTimeout(() => draw(lab, people, { size, turns: others }));
}

export function start() {
  /** @type {{lab: Lab, people: ReturnType<typeof peopleOf>} | undefined} */
  let ready;
  globalThis.onmessage = async (/** @type {MessageEvent} */ { data: asked }) => {
    if (ready === undefined) {
      const lab = new Lab(await load(asked.module, "float64"), asked.data);
      const people = peopleOf(lab);
      ready = { lab, people };
      setTimeout(() => draw(lab, people, asked.expected));
      return globalThis.postMessage("ready");
    }
    const part = some(ready.lab, ready.people, asked.situation, asked.first, asked.count);
    globalThis.postMessage(part, { transfer: [part.glucose.buffer] });
  };
}
