// @ts-check
/** Sums, products and factors of small matrices, quick enough for a design at each move of a slider. */

/** @typedef {Float64Array} Square a square matrix, row by row */

/** The factor L of `L L' = I + a b'`, of the first rows of both. @param {Square} a @param {Square} b @param {number} rank @param {number} n @param {Square} L */
export function cholesky(a, b, rank, n, L) {
  for (let i = 0; i < rank; i++) {
    for (let j = 0; j <= i; j++) {
      let sum = i === j ? 1 : 0;
      for (let k = 0; k < n; k++) sum += a[i * n + k] * b[j * n + k];
      for (let k = 0; k < j; k++) sum -= L[i * n + k] * L[j * n + k];
      L[i * n + j] = i === j ? Math.sqrt(sum) : sum / L[j * n + j];
    }
  }
}

/** Subtract a multiple of a row from another. @param {Square} from @param {number} at @param {Square} row @param {number} of @param {number} n @param {number} factor */
export function subtract(from, at, row, of, n, factor) {
  for (let j = 0; j < n; j++) from[at + j] -= factor * row[of + j];
}

/** Solve `L X = B` in place, of B the first rows. @param {Square} L @param {Square} B @param {number} rank @param {number} n */
export function forward(L, B, rank, n) {
  for (let i = 0; i < rank; i++) {
    for (let k = 0; k < i; k++) subtract(B, i * n, B, k * n, n, L[i * n + k]);
    for (let j = 0; j < n; j++) B[i * n + j] /= L[i * n + i];
  }
}

/** Solve `L' X = B` in place, of B the first rows. @param {Square} L @param {Square} B @param {number} rank @param {number} n */
export function backward(L, B, rank, n) {
  for (let i = rank - 1; i >= 0; i--) {
    for (let k = i + 1; k < rank; k++) subtract(B, i * n, B, k * n, n, L[k * n + i]);
    for (let j = 0; j < n; j++) B[i * n + j] /= L[i * n + i];
  }
}

/** @param {ArrayLike<number>} a @param {ArrayLike<number>} b @param {number} [from] the first number of b */
export function dot(a, b, from = 0) {
  let total = 0;
  for (let i = 0; i < a.length; i++) total += a[i] * b[from + i];
  return total;
}

/** @param {Square} a */
export function size(a) {
  let most = 0;
  for (let i = 0; i < a.length; i++) most = Math.max(most, Math.abs(a[i]));
  return most;
}

/** @param {Square} a @param {Square} b what is added to it */
export function add(a, b) {
  for (let i = 0; i < a.length; i++) a[i] += b[i];
}

/** @param {Square} a @param {number} n @param {Square} into */
export function transpose(a, n, into) {
  for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) into[j * n + i] = a[i * n + j];
}

/**
 * `a' b`, which is known to be symmetric, so that half of it is computed.
 * @param {Square} a @param {Square} b @param {number} n a multiple of four @param {Square} into neither of the two
 * @param {number} [rows] of a and b
 */
export function symmetric(a, b, n, into, rows = n) {
  for (let i = 0; i < n; i += 2) {
    for (let j = i - (i % 4); j < n; j += 4) {
      let s0 = 0;
      let s1 = 0;
      let s2 = 0;
      let s3 = 0;
      let t0 = 0;
      let t1 = 0;
      let t2 = 0;
      let t3 = 0;
      for (let k = 0, of = i, at = j; k < rows; k++, of += n, at += n) {
        const s = a[of];
        const t = a[of + 1];
        const b0 = b[at];
        const b1 = b[at + 1];
        const b2 = b[at + 2];
        const b3 = b[at + 3];
        s0 += s * b0;
        s1 += s * b1;
        s2 += s * b2;
        s3 += s * b3;
        t0 += t * b0;
        t1 += t * b1;
        t2 += t * b2;
        t3 += t * b3;
      }
      const first = i * n + j;
      const second = first + n;
      into[first] = s0;
      into[first + 1] = s1;
      into[first + 2] = s2;
      into[first + 3] = s3;
      into[second] = t0;
      into[second + 1] = t1;
      into[second + 2] = t2;
      into[second + 3] = t3;
    }
  }
  for (let i = 0; i < n; i++) for (let j = 0; j < i; j++) into[i * n + j] = into[j * n + i];
}

/**
 * Two rows and four columns at a time, so that sums stay in registers.
 * @param {Square} a @param {Square} b @param {number} n a multiple of four @param {Square} into neither of the two
 * @param {number} [rows] an even number of rows of a
 */
export function product(a, b, n, into, rows = n) {
  for (let i = 0; i < rows; i += 2) {
    const first = i * n;
    const second = first + n;
    for (let j = 0; j < n; j += 4) {
      let s0 = 0;
      let s1 = 0;
      let s2 = 0;
      let s3 = 0;
      let t0 = 0;
      let t1 = 0;
      let t2 = 0;
      let t3 = 0;
      for (let k = 0, at = j; k < n; k++, at += n) {
        const s = a[first + k];
        const t = a[second + k];
        const b0 = b[at];
        const b1 = b[at + 1];
        const b2 = b[at + 2];
        const b3 = b[at + 3];
        s0 += s * b0;
        s1 += s * b1;
        s2 += s * b2;
        s3 += s * b3;
        t0 += t * b0;
        t1 += t * b1;
        t2 += t * b2;
        t3 += t * b3;
      }
      into[first + j] = s0;
      into[first + j + 1] = s1;
      into[first + j + 2] = s2;
      into[first + j + 3] = s3;
      into[second + j] = t0;
      into[second + j + 1] = t1;
      into[second + j + 2] = t2;
      into[second + j + 3] = t3;
    }
  }
}

/**
 * The solutions V and U of `W V = A` and `W U = B`, by elimination with row exchanges.
 * @param {Square} W @param {Square} A @param {Square} B @param {number} n
 * @param {Float64Array} rows room for the three, side by side, and for the pivots @param {Square} V @param {Square} U
 */
export function solve(W, A, B, n, rows, V, U) {
  const width = 3 * n;
  const pivots = rows.subarray(3 * n * n);
  for (let i = 0; i < n; i++) {
    const to = i * width;
    const from = i * n;
    for (let j = 0; j < n; j++) {
      rows[to + j] = W[from + j];
      rows[to + n + j] = A[from + j];
      rows[to + 2 * n + j] = B[from + j];
    }
  }
  for (let k = 0; k < n; k++) {
    let pivot = k;
    for (let i = k + 1; i < n; i++) {
      if (Math.abs(rows[i * width + k]) > Math.abs(rows[pivot * width + k])) pivot = i;
    }
    const from = k * width;
    for (let j = k, to = pivot * width + k; pivot !== k && j < width; j++, to++) {
      const kept = rows[to];
      rows[to] = rows[from + j];
      rows[from + j] = kept;
    }
    pivots[k] = rows[from + k];
    for (let i = 0; i < n; i++) {
      const to = i * width;
      const factor = i === k ? 0 : rows[to + k] / pivots[k];
      if (factor === 0) continue;
      // Four columns at a time; what is in the columns before k is not read again.
      for (let j = k - (k % 4); j < width; j += 4) {
        const at = to + j;
        const of = from + j;
        rows[at] -= factor * rows[of];
        rows[at + 1] -= factor * rows[of + 1];
        rows[at + 2] -= factor * rows[of + 2];
        rows[at + 3] -= factor * rows[of + 3];
      }
    }
  }
  for (let i = 0; i < n; i++) {
    const from = i * width;
    for (let j = 0; j < n; j++) {
      V[i * n + j] = rows[from + n + j] / pivots[i];
      U[i * n + j] = rows[from + 2 * n + j] / pivots[i];
    }
  }
}
