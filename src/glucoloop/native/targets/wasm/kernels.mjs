// @ts-check
/**
 * Runs the functions of a WebAssembly module that `glucoloop.native.targets.wasm` made.
 *
 * Arrays are of numbers row by row, people trailing: `person` and `carry` are (numbers, people), `own` and `outputs`
 * (samples, numbers, people), and `shared` (samples, numbers).
 */

/**
 * What one function of the module takes and gives, in numbers.
 * @typedef {object} Sizes
 * @property {number} person
 * @property {number} carry
 * @property {number} own
 * @property {number} shared
 * @property {number} outputs
 */

/** @typedef {Float64Array | Float32Array} Numbers */

const VECTOR_BYTES = 16;
const PAGE_BYTES = 65536;

/** The functions of a module with its memory. */
export class Kernels {
  /**
   * @param {WebAssembly.Instance} instance
   * @param {"float64" | "float32"} precision
   */
  constructor(instance, precision) {
    this.exports = /** @type {Record<string, any>} */ (instance.exports);
    /** @type {WebAssembly.Memory} */
    this.memory = this.exports.memory;
    this.array = precision === "float64" ? Float64Array : Float32Array;
    this.lanes = VECTOR_BYTES / this.array.BYTES_PER_ELEMENT;
    this.base = Math.ceil(this.exports.__heap_base.value / VECTOR_BYTES) * VECTOR_BYTES;
  }

  /**
   * Carry people through all samples.
   * @param {string} name of the function
   * @param {Sizes} sizes
   * @param {number} samples
   * @param {number} people
   * @param {{person?: ArrayLike<number>, carry?: ArrayLike<number>, own?: ArrayLike<number>,
   *   shared?: ArrayLike<number>}} given what is left out is zero
   * @returns {{carry: Numbers, outputs: Numbers}} the state at the end, and the outputs of each sample
   */
  run(name, sizes, samples, people, given) {
    const columns = Math.ceil(people / this.lanes) * this.lanes;
    const rows = {
      person: sizes.person,
      carry: sizes.carry,
      own: sizes.own * samples,
      shared: sizes.shared * samples,
      outputs: sizes.outputs * samples,
    };
    const width = { person: columns, carry: columns, own: columns, shared: 1, outputs: columns };
    const at = { person: 0, carry: 0, own: 0, shared: 0, outputs: 0 };
    const names = /** @type {(keyof typeof at)[]} */ (Object.keys(at));
    let end = this.base;
    for (const array of names) {
      at[array] = end;
      end += Math.ceil((rows[array] * width[array] * this.array.BYTES_PER_ELEMENT) / VECTOR_BYTES) * VECTOR_BYTES;
    }
    const missing = end - this.memory.buffer.byteLength;
    if (missing > 0) this.memory.grow(Math.ceil(missing / PAGE_BYTES));

    /** @param {keyof typeof at} array */
    const view = (array) => new this.array(this.memory.buffer, at[array], rows[array] * width[array]);
    for (const array of names) {
      if (array === "outputs") continue;
      const from = given[array];
      const wide = array === "shared" ? 1 : people;
      const into = view(array);
      if (from === undefined) {
        into.fill(0);
        continue;
      }
      if (from.length !== rows[array] * wide) {
        throw new RangeError(`${name} takes ${rows[array] * wide} numbers of ${array}, not ${from.length}`);
      }
      for (let row = 0; row < rows[array]; row++) {
        for (let column = 0; column < width[array]; column++) {
          into[row * width[array] + column] = from[row * wide + Math.min(column, wide - 1)];
        }
      }
    }
    const { person, carry, own, shared, outputs } = at;
    this.exports[name](person, carry, own, shared, outputs, columns, 0, columns / this.lanes, samples);

    /** @param {"carry" | "outputs"} array */
    const narrow = (array) => {
      const from = view(array);
      const found = new this.array(rows[array] * people);
      for (let row = 0; row < rows[array]; row++) {
        for (let person = 0; person < people; person++) {
          found[row * people + person] = from[row * columns + person];
        }
      }
      return found;
    };
    return { carry: narrow("carry"), outputs: narrow("outputs") };
  }
}

/**
 * @param {Uint8Array} module
 * @param {"float64" | "float32"} precision
 * @returns {Promise<Kernels>}
 */
export async function load(module, precision) {
  const { instance } = await WebAssembly.instantiate(/** @type {BufferSource} */ (module), {});
  return new Kernels(instance, precision);
}
