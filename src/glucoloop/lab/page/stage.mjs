// @ts-check
/** A function of the module with its arrays, and a person in the plant. */

/** @typedef {import("./design.mjs").Numbers} Numbers */
/** @typedef {import("./lab.mjs").Lab} Lab */

/**
 * A person at rest.
 * @typedef {object} Body
 * @property {ArrayLike<number>} numbers of the patient that differ between people
 * @property {ArrayLike<number>} matrices of the integrator, without their zeros
 * @property {ArrayLike<number>} [driven] the first of them where they are the person's own
 * @property {number[]} gut numbers in which the guts of people differ
 * @property {ArrayLike<number>} x state
 * @property {number} basal_insulin_mU_min
 * @property {number} glucose_mg_dl
 */

/** Legendre moments of a meal, as a step of the plant takes them. */
export const MOMENTS = 3;

/** Name of a function of a family's patients. @param {string} family @param {"plant" | "meal" | "eaten" | "gut" | "person"} what */
export function functionOf(family, what) {
  return `${family.replace(/\W/g, "_")}_${what}`;
}

/** @param {Record<string, number>} names */
function total(names) {
  return Object.values(names).reduce((a, b) => a + b, 0);
}

/** A function of one vector of people, whose arrays are read and written in place. */
export class Stage {
  /**
   * @param {Lab} lab
   * @param {string} name
   */
  constructor(lab, name) {
    this.fields = lab.data.functions[name];
    const { person, per_person, carry, own, shared, outputs } = this.fields;
    const sizes = {
      person: total(person),
      per_person,
      carry: total(carry),
      own: total(own),
      shared: total(shared),
      outputs: total(outputs),
    };
    this.lanes = lab.kernels.lanes;
    /** Lists that the function holds, of all people of the vector. @type {Record<string, number[]>} */
    this.given = {};
    this.prepared = lab.kernels.prepare(name, sizes, this.lanes);
    this.person = this.prepared.view("person");
    this.carry = this.prepared.view("carry");
    this.own = this.prepared.view("own");
    this.shared = this.prepared.view("shared");
    this.outputs = this.prepared.view("outputs");
  }

  /** Find the arrays again after the memory of the module has grown. */
  refresh() {
    this.person = this.prepared.view("person");
    this.carry = this.prepared.view("carry");
    this.own = this.prepared.view("own");
    this.shared = this.prepared.view("shared");
    this.outputs = this.prepared.view("outputs");
  }

  /**
   * Set the numbers of all people of the vector, or of one of them, without computing what follows from them.
   * @param {ArrayLike<number>} numbers
   * @param {number} [lane]
   * @param {number} [at] place of the first
   */
  set(numbers, lane, at = 0) {
    const { lanes, person } = this;
    for (let i = 0; i < numbers.length; i++) {
      if (lane === undefined) for (let l = 0; l < lanes; l++) person[(at + i) * lanes + l] = numbers[i];
      else person[(at + i) * lanes + lane] = numbers[i];
    }
  }

  /** Place of the numbers of a name among those of a person, or of another group. @param {string} name @param {"person" | "carry" | "own" | "outputs"} [group] */
  place(name, group = "person") {
    let at = 0;
    for (const other in this.fields[group]) {
      if (other === name) return at;
      at += this.fields[group][other];
    }
    throw new RangeError(`the function has no ${name}`);
  }

  /**
   * Give numbers by name to all people of the vector; a list that the function holds already is not copied again.
   * What is not given, no step uses.
   * @param {Numbers} given
   */
  give(given) {
    const { lanes, person, fields, given: before } = this;
    let at = 0;
    for (const name in fields.person) {
      const count = fields.person[name];
      const own = given[name];
      if (typeof own === "object") {
        for (let i = 0; own !== before[name] && i < count; i++) {
          const value = i < own.length ? own[i] : 0;
          for (let lane = 0; lane < lanes; lane++) person[(at + i) * lanes + lane] = value;
        }
        before[name] = own;
      } else {
        delete before[name];
        person.fill(0, at * lanes, (at + count) * lanes);
        if (own !== undefined) person.fill(own, at * lanes, (at + 1) * lanes);
      }
      at += count;
    }
    this.prepared.computePerPerson();
  }

  step() {
    this.prepared.advance();
  }
}

/** Who is in all lanes of a plant, if it is one person. @type {WeakMap<Stage, Body>} */
const held = new WeakMap();

/**
 * Put people into the plant: constants, matrices and states. Only the states change while it is stepped, so that a
 * person who is in it already is not put there again.
 * @param {Stage} plant
 * @param {Body[]} people one for each lane
 */
export function put(plant, people) {
  const { person } = plant.fields;
  const first = Object.keys(person).find((name) => name !== "matrices");
  // Where all patients of a family are alike, their numbers are part of the function.
  const of_patient = first === undefined ? 0 : plant.place(first);
  const of_matrices = plant.place("matrices");
  people.forEach(({ x }, lane) => {
    for (let i = 0; i < x.length; i++) plant.carry[i * plant.lanes + lane] = x[i];
  });
  const [alike] = people;
  if (held.get(plant) === alike && people.every((body) => body === alike)) return;
  people.forEach(({ numbers, matrices, driven }, lane) => {
    plant.set(matrices, lane, of_matrices);
    if (driven !== undefined) plant.set(driven, lane, of_matrices);
    plant.set(numbers, lane, of_patient);
  });
  plant.prepared.computePerPerson();
  if (people.every((body) => body === alike)) held.set(plant, alike);
  else held.delete(plant);
}
