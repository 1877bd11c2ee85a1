// @ts-check
/**
 * Runs the functions of a WebAssembly module that `glucoloop.native.targets.wasm` made.
 *
 * People are in vectors of `Kernels.lanes`, whose numbers lie together: for each vector `per_person` is
 * (numbers, lanes), the first of them those of the people, `carry` (numbers, lanes), and `own` and `outputs` (samples,
 * numbers, lanes). `shared` is (samples, numbers).
 */

/**
 * What one function of the module takes and gives, in numbers.
 * @typedef {object} Sizes
 * @property {number} person
 * @property {number} per_person what it computes once for a person
 * @property {number} carry
 * @property {number} own
 * @property {number} shared
 * @property {number} outputs
 */

/** @typedef {Float64Array | Float32Array} Numbers */

/** @typedef {"person" | "carry" | "own" | "shared" | "outputs"} Group */

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
    this.kernels = kernels;
    this.name = name;
    this.people = people;
    this.samples = samples;
    this.vectors = Math.ceil(people / kernels.lanes);
    /** Rows of a group for each vector. */
    this.rows = {
      person: sizes.person,
      per_person: sizes.person + sizes.per_person,
      carry: sizes.carry,
      own: sizes.own * samples,
      shared: sizes.shared * samples,
      outputs: sizes.outputs * samples,
    };
    const { lanes } = kernels;
    const place = (/** @type {"per_person" | "carry" | "own" | "outputs"} */ group) =>
      kernels.reserve(this.rows[group] * lanes * this.vectors);
    const per_person = place("per_person");
    this.at = {
      person: per_person,
      per_person,
      carry: place("carry"),
      own: place("own"),
      shared: kernels.reserve(this.rows.shared),
      outputs: place("outputs"),
    };
    this.begin = kernels.exports[`${name}_per_person`];
    this.step = kernels.exports[name];
  }

  /**
   * Numbers of a group of one vector, in the module's memory. Memory that grows makes them useless.
   * @param {Group} group
   * @param {number} [vector]
   * @returns {Numbers}
   */
  view(group, vector = 0) {
    const { array, memory, lanes } = this.kernels;
    if (group === "shared") return new array(memory.buffer, this.at.shared, this.rows.shared);
    const apart = group === "person" ? this.rows.per_person : this.rows[group];
    const at = this.at[group] + vector * apart * lanes * array.BYTES_PER_ELEMENT;
    return new array(memory.buffer, at, this.rows[group] * lanes);
  }

  /**
   * Set a group of all people, (rows, people); lanes that are left over repeat the last person.
   * @param {Group} group
   * @param {ArrayLike<number>} numbers
   */
  set(group, numbers) {
    const rows = this.rows[group];
    const wide = group === "shared" ? 1 : this.people;
    if (numbers.length !== rows * wide) {
      throw new RangeError(`${this.name} takes ${rows * wide} numbers of ${group}, not ${numbers.length}`);
    }
    if (group === "shared") return this.view(group).set(numbers);
    const { lanes } = this.kernels;
    for (let vector = 0; vector < this.vectors; vector++) {
      const into = this.view(group, vector);
      for (let i = 0; i < into.length; i++) {
        const person = Math.min(vector * lanes + (i % lanes), wide - 1);
        into[i] = numbers[Math.floor(i / lanes) * wide + person];
      }
    }
  }

  /**
   * A copy of a group of all people, (rows, people).
   * @param {Group} group
   * @returns {Numbers}
   */
  get(group) {
    const { lanes, array } = this.kernels;
    const numbers = new array(this.rows[group] * this.people);
    for (let person = 0; person < this.people; person++) {
      const from = this.view(group, Math.floor(person / lanes));
      for (let row = 0; row < this.rows[group]; row++) {
        numbers[row * this.people + person] = from[row * lanes + (person % lanes)];
      }
    }
    return numbers;
  }

  /** Compute what is the same at every sample from the numbers of the people of the first vector. */
  computePerPerson() {
    this.begin(this.at.per_person);
  }

  /** Carry the people of the first vector through the samples: the state becomes that at the end. */
  advance() {
    const { per_person, carry, own, shared, outputs } = this.at;
    this.step(per_person, carry, own, shared, outputs, this.samples);
  }

  /** Carry all people through the samples. */
  run() {
    const { per_person, carry, own, shared, outputs } = this.at;
    const bytes = VECTOR_BYTES;
    for (let vector = 0; vector < this.vectors; vector++) {
      const at = (/** @type {number} */ first, /** @type {"per_person" | "carry" | "own" | "outputs"} */ group) =>
        first + vector * this.rows[group] * bytes;
      this.begin(at(per_person, "per_person"));
      this.step(
        at(per_person, "per_person"),
        at(carry, "carry"),
        at(own, "own"),
        shared,
        at(outputs, "outputs"),
        this.samples,
      );
    }
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
 * @param {Uint8Array | WebAssembly.Module} module its bytes, or what they were compiled to elsewhere
 * @param {"float64" | "float32"} precision
 * @returns {Promise<Kernels>}
 */
export async function load(module, precision) {
  const compiled = module instanceof WebAssembly.Module ? module : await WebAssembly.compile(/** @type {BufferSource} */ (module));
  return new Kernels(await WebAssembly.instantiate(compiled, {}), precision);
}
