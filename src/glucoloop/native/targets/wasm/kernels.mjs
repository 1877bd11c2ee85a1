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

/** @typedef {keyof Sizes} Group */

const VECTOR_BYTES = 16;
const PAGE_BYTES = 65536;

/** Arrays of one function in the module's memory, to be filled, run and read again and again. */
export class Prepared {
  /**
   * @param {Kernels} kernels
   * @param {string} name
   * @param {Sizes} sizes
   * @param {number} people
   * @param {number} samples
   */
  constructor(kernels, name, sizes, people, samples) {
    this.name = name;
    this.people = people;
    this.samples = samples;
    this.columns = Math.ceil(people / kernels.lanes) * kernels.lanes;
    this.rows = {
      person: sizes.person,
      carry: sizes.carry,
      own: sizes.own * samples,
      shared: sizes.shared * samples,
      outputs: sizes.outputs * samples,
    };
    this.kernels = kernels;
    const place = (/** @type {Group} */ group) => kernels.reserve(this.rows[group] * this.width(group));
    this.at = {
      person: place("person"),
      carry: place("carry"),
      own: place("own"),
      shared: place("shared"),
      outputs: place("outputs"),
    };
  }

  /** @param {Group} group */
  width(group) {
    return group === "shared" ? 1 : this.columns;
  }

  /**
   * The numbers of a group, with the columns that fill the last vector. Memory that grows makes it useless.
   * @param {Group} group
   * @returns {Numbers}
   */
  view(group) {
    return new this.kernels.array(this.kernels.memory.buffer, this.at[group], this.rows[group] * this.width(group));
  }

  /**
   * Set a group; the columns that fill the last vector repeat the last person.
   * @param {Group} group
   * @param {ArrayLike<number>} numbers
   */
  set(group, numbers) {
    const rows = this.rows[group];
    const width = this.width(group);
    const wide = group === "shared" ? 1 : this.people;
    if (numbers.length !== rows * wide) {
      throw new RangeError(`${this.name} takes ${rows * wide} numbers of ${group}, not ${numbers.length}`);
    }
    const into = this.view(group);
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < width; column++) {
        into[row * width + column] = numbers[row * wide + Math.min(column, wide - 1)];
      }
    }
  }

  /**
   * A copy of a group, without the columns that fill the last vector.
   * @param {Group} group
   * @returns {Numbers}
   */
  get(group) {
    const from = this.view(group);
    const found = new this.kernels.array(this.rows[group] * this.people);
    for (let row = 0; row < this.rows[group]; row++) {
      for (let person = 0; person < this.people; person++) {
        found[row * this.people + person] = from[row * this.columns + person];
      }
    }
    return found;
  }

  /** Carry the people through the samples: the state becomes that at the end. */
  run() {
    const { person, carry, own, shared, outputs } = this.at;
    const vectors = this.columns / this.kernels.lanes;
    this.kernels.exports[this.name](person, carry, own, shared, outputs, this.columns, 0, vectors, this.samples);
  }
}

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
    this.end = Math.ceil(this.exports.__heap_base.value / VECTOR_BYTES) * VECTOR_BYTES;
  }

  /**
   * Address of room for numbers, which stays theirs.
   * @param {number} numbers
   */
  reserve(numbers) {
    const at = this.end;
    this.end += Math.ceil((numbers * this.array.BYTES_PER_ELEMENT) / VECTOR_BYTES) * VECTOR_BYTES;
    const missing = this.end - this.memory.buffer.byteLength;
    if (missing > 0) this.memory.grow(Math.ceil(missing / PAGE_BYTES));
    return at;
  }

  /**
   * Room for the arrays of a function.
   * @param {string} name
   * @param {Sizes} sizes
   * @param {number} people
   * @param {number} samples
   */
  prepare(name, sizes, people = 1, samples = 1) {
    return new Prepared(this, name, sizes, people, samples);
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
