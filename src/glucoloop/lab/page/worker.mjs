// @ts-check
/** A worker: it is given the module and the data of the page once, then simulates the people it is asked for. */

import { load } from "../../native/targets/wasm/kernels.mjs";
import { Lab } from "./loop.mjs";
import { some } from "./many.mjs";
import { peopleOf } from "./people.mjs";

export function start() {
  /** @type {{lab: Lab, people: ReturnType<typeof peopleOf>} | undefined} */
  let ready;
  globalThis.onmessage = async (/** @type {MessageEvent} */ { data: asked }) => {
    if (ready === undefined) {
      const lab = new Lab(await load(asked.module, "float64"), asked.data);
      ready = { lab, people: peopleOf(lab) };
      return globalThis.postMessage("ready");
    }
    const part = some(ready.lab, ready.people, asked.situation, asked.first, asked.count);
    globalThis.postMessage(part, { transfer: [part.glucose.buffer] });
  };
}
