// @ts-check
/** Design of a Kalman filter: the steady gain, from the Riccati equation by doubling. */

import { add, backward, cholesky, dot, forward, product, size, solve, subtract, symmetric, transpose } from "./matrices.mjs";

/** @typedef {import("./matrices.mjs").Square} Square */

const NAMES = /** @type {const} */ (["A", "G", "P", "W", "V", "U", "PV", "more", "moved", "H", "HP", "HPA", "HA", "L"]);
/** Matrices that are used at each solution again, by their size. @type {Map<number, Record<typeof NAMES[number] | "rows", Square>>} */
const workspaces = new Map();

/** @param {number} n */
function workspace(n) {
  let found = workspaces.get(n);
  if (found === undefined) {
    const made = Object.fromEntries(NAMES.map((name) => [name, new Float64Array(n * n)]));
    found = /** @type {Record<typeof NAMES[number] | "rows", Square>} */ ({ ...made, rows: new Float64Array(3 * n * n + n) });
    workspaces.set(n, found);
  }
  return found;
}

const MOST_DOUBLINGS = 60;
/** Relative addition after which another doubling would add less than rounding does. */
const CONVERGED = 1e-9;

/**
 * The steady Kalman gain in filter form, `P C' / (C P C' + R)`, of a system that is read by one row C.
 *
 * The Riccati equation is solved by doubling: after k steps P is that of 2^k samples, so that some ten are enough.
 * With `W = I + G P`, a step is
 *
 *     P + A' P W^-1 A,    G + A W^-1 G A',    A W^-1 A.
 *
 * At first `G = C' C / R`, and a step doubles its rank. While it is small, G is kept as `H' H`, of few rows, and W^-1
 * follows from a matrix of that size, `W^-1 = I - H' (I + H P H')^-1 H P`.
 * E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, "Structure-preserving algorithms for periodic discrete-time algebraic
 * Riccati equations", Int. J. Control 77(8), 2004.
 * @param {number[][]} Phi (n, n)
 * @param {number[]} C (n,)
 * @param {number[]} Q (n,) variances of the process noise
 * @param {number} R variance of a reading
 * @returns {number[]} (n,)
 */
export function steadyKalmanGain(Phi, C, Q, R) {
  const states = C.length;
  const n = Math.ceil(states / 4) * 4; // with zeros for states that there are not
  const { A, G, P, W, V, U, PV, more, moved, H, HP, HPA, HA, L, rows } = workspace(n);
  for (const matrix of [P, H]) matrix.fill(0);
  A.set(transition(Phi, n));
  const root = Math.sqrt(R);
  for (let i = 0; i < states; i++) {
    P[i * n + i] = Q[i];
    H[i] = C[i] / root;
  }
  let rank = 1;
  for (let step = 0; step < MOST_DOUBLINGS; step++) {
    const thin = 2 * rank <= n;
    if (thin) {
      // L L' = I + H P H', V = A - H' (L L')^-1 H P A, and the new rows of H are L^-1 H A'.
      const even = rank + (rank % 2); // the row behind the last is zero
      product(P, A, n, PV);
      product(H, P, n, HP, even);
      product(H, PV, n, HPA, even);
      cholesky(HP, H, rank, n, L);
      forward(L, HPA, rank, n);
      backward(L, HPA, rank, n);
      V.set(A);
      for (let k = 0; k < rank; k++) {
        for (let i = 0; i < n; i++) if (H[k * n + i] !== 0) subtract(V, i * n, HPA, k * n, n, H[k * n + i]);
      }
      symmetric(V, PV, n, more);
    } else {
      product(G, P, n, W);
      for (let i = 0; i < n; i++) W[i * n + i] += 1;
      solve(W, A, G, n, rows, V, U); // W^-1 A and W^-1 G
      product(P, V, n, PV);
      symmetric(A, PV, n, more);
    }
    add(P, more);
    // It converges quadratically: what the next doubling would add is the square of this.
    if (size(more) <= CONVERGED * size(P)) break;
    if (thin) {
      transpose(A, n, moved);
      product(H, moved, n, HA, rank + (rank % 2));
      forward(L, HA, rank, n);
      for (let i = 0; i < rank * n; i++) H[rank * n + i] = HA[i];
      rank *= 2;
      if (2 * rank > n) symmetric(H, H, n, G, rank);
    } else {
      product(A, U, n, moved);
      transpose(moved, n, W);
      transpose(A, n, PV);
      symmetric(W, PV, n, more);
      add(G, more);
    }
    product(A, V, n, moved);
    A.set(moved);
  }
  const seen = C.map((_, i) => dot(C, P, i * n));
  const gain = seen.map((value) => value / (dot(C, seen) + R));
  if (!gain.every(Number.isFinite)) throw new RangeError("these variances give no Kalman filter; bring Q and R closer");
  return gain;
}

/** Transposed matrices of the models, with zeros for states that there are not. @type {WeakMap<number[][], Square>} */
const transitions = new WeakMap();

/** @param {number[][]} Phi @param {number} n */
function transition(Phi, n) {
  let found = transitions.get(Phi);
  if (found === undefined) {
    found = new Float64Array(n * n);
    for (let i = 0; i < Phi.length; i++) for (let j = 0; j < Phi.length; j++) found[i * n + j] = Phi[j][i];
    transitions.set(Phi, found);
  }
  return found;
}
