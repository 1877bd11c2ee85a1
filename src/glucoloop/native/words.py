"""Random numbers as a scalar program: what JAX draws from a key, bit by bit, in words of 32 bits.

A `Drawing` is lowered like any other function, with what `_WordFlattener` adds to it. Keys and whole numbers of 64 bits
are pairs of words. How JAX splits keys, folds numbers into them and draws bits from them is asked of JAX itself, and
`glucoloop.threefry` has the function of their bits that it all comes to. Numbers are of double precision, as those that
one person's loop draws.
"""

from __future__ import annotations

import functools
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.native import primitives
from glucoloop.native.flatten import MOVES, Drawing, Flattener
from glucoloop.native.loops import Values
from glucoloop.native.lower import Lowered, lower
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.program import PAIR, WORD, Value
from glucoloop.threefry import threefry_2x32

_BITS: Final = 32
_OF_WORDS: Final = {
    "and": "word_and",
    "or": "word_or",
    "xor": "word_xor",
    "add": "word_add",
    "shift_left": "shift_left",
    "shift_right_logical": "shift_right",
}
_OTHER_OPERATIONS: Final = MOVES | {
    *primitives.CALLS, "scan", "gather", "dynamic_slice", "random_wrap", "random_unwrap", "threefry2x32",
    "convert_element_type", "bitcast_convert_type",
}  # fmt: skip
"""Other operations that take words."""


def lower_drawing(drawing: Drawing, key: Any, index: Any, *, as_written: bool = False) -> Lowered:
    """Lower a drawing, with the words of a key as the numbers of a person, and as state the number of the sample.

    The outputs of a sample are the numbers that are drawn for it, and the state after it is the next sample's number.
    `UnsupportedError` names what is drawn otherwise than from words of 32 bits and by operations that native code has.
    """

    def draw(words: Any, index: Any, own: Any, shared: Any, rng: Any) -> tuple[Any, Any]:
        del own, shared, rng
        return index + 1, drawing(jax.random.wrap_key_data(words), index)

    words = jax.eval_shape(jax.random.key_data, key)
    return lower(draw, words, index, (), (), as_written=as_written, flattener=_WordFlattener)


class _WordFlattener(Flattener):
    """Evaluates a jaxpr with keys and whole numbers without sign, which are words or pairs of them."""

    def input(self, name: tuple[str, int], aval: Any, level: int) -> Values:
        """An input of the program; a whole number without sign is a word."""
        if aval.dtype != np.uint32:
            return super().input(name, aval, level)
        flat = [self.program.input((*name, i), level, WORD) for i in range(aval.size)]
        return np.array(flat, np.int64).reshape(aval.shape)

    def constants(self, array: Any) -> Values:
        """Numbers as values."""
        numbers = np.asarray(array)
        if numbers.dtype not in (np.uint32, np.uint64):
            return super().constants(numbers)
        word, wide = self.program.word, numbers.dtype == np.uint64
        flat = [self._pair(word(n >> 32), word(n)) if wide else word(n) for n in numbers.ravel().tolist()]
        return np.array(flat, np.int64).reshape(numbers.shape)

    def _equation(self, equation: Any, inputs: list[Any]) -> list[Any]:
        name, unsigned = equation.primitive.name, any(map(self._unsigned, inputs))
        function = primitives.of_keys(equation)
        if function is not None:
            keys, *rest = inputs
            if keys.size != 1:
                raise UnsupportedError(f"the operation {name!r} of several keys at once")
            (result,) = self._run(function, [self._do_random_unwrap(equation, keys).reshape(2), *rest])
            return [result if name == "random_bits" else self._do_random_wrap(equation, result)]
        if unsigned and name in _OF_WORDS:
            return [self._elementwise(functools.partial(self._of_words, name), *inputs)]
        if unsigned and name not in _OTHER_OPERATIONS:
            raise UnsupportedError(f"the operation {name!r} of whole numbers without sign")
        return super()._equation(equation, inputs)

    def _unsigned(self, values: Values) -> bool:
        return values.size > 0 and self.program.types[int(values.flat[0])] in (WORD, PAIR)

    def _pair(self, high: Value, low: Value) -> Value:
        return self.program.apply("pair", high, low)

    def _two(self, pair: Value) -> tuple[Value, Value]:
        """The words of a pair."""
        high, low = self.program.operations[pair][1]
        return high, low

    def _of_words(self, name: str, x: Value, y: Value) -> Value:
        """An operation on the bits of words, or of pairs of words."""
        p, wide = self.program, self.program.types[x] == PAIR
        if name.startswith("shift"):
            bits = p.constants.get(self._two(y)[1] if wide else y)
            if bits is None:
                raise UnsupportedError("a shift by a number of bits that depends on what happens")
            return self._shifted(_OF_WORDS[name], x, int(bits))
        if not wide:
            return p.apply(_OF_WORDS[name], x, y)
        if name == "add":
            raise UnsupportedError("sums of whole numbers of 64 bits")
        return self._pair(
            *(p.apply(_OF_WORDS[name], *of_each) for of_each in zip(self._two(x), self._two(y), strict=True))
        )

    def _shifted(self, way: str, x: Value, bits: int) -> Value:
        """A word or a pair, shifted to the left or to the right."""
        p, back = self.program, "shift_right" if way == "shift_left" else "shift_left"
        if p.types[x] == WORD:
            return x if bits == 0 else p.apply(way, x, p.word(bits)) if bits < _BITS else p.word(0)
        from_, to = self._two(x) if way == "shift_right" else self._two(x)[::-1]
        crossing = (
            self._shifted(back, from_, _BITS - bits) if bits <= _BITS else self._shifted(way, from_, bits - _BITS)
        )
        shifted = self._shifted(way, from_, bits), p.apply("word_or", self._shifted(way, to, bits), crossing)
        return self._pair(*(shifted if way == "shift_right" else shifted[::-1]))

    def _do_random_wrap(self, equation: Any, words: Values) -> Values:
        """Keys, of pairs of words."""
        del equation
        keys = [self._pair(*of_key) for of_key in words.reshape(-1, 2).tolist()]
        return np.array(keys, np.int64).reshape(words.shape[:-1])

    def _do_random_unwrap(self, equation: Any, keys: Values) -> Values:
        del equation
        return np.array([self._two(key) for key in keys.ravel().tolist()], np.int64).reshape((*keys.shape, 2))

    def _do_iota_2x32_shape(self, equation: Any) -> list[Values]:
        return [self.constants(np.asarray(part)) for part in primitives.bind(equation, [])]

    def _do_threefry2x32(self, equation: Any, *words: Values) -> list[Values]:
        del equation
        examples = [np.zeros(word.shape, np.uint32) for word in words]
        closed = jax.make_jaxpr(lambda k, h, x, y: threefry_2x32((k, h), x, y))(*examples)
        return self._run(closed, words)

    def _do_convert_element_type(self, equation: Any, a: Values) -> Values:
        source, target, p = equation.invars[0].aval.dtype, primitives.new_dtype(equation), self.program
        if source == target:
            return a
        match source, target:
            case np.uint32, np.uint64:
                return self._elementwise(lambda x: self._pair(p.word(0), x), a)
            case np.uint64, np.uint32:
                return self._elementwise(lambda x: self._two(x)[1], a)
            case np.uint32, _ if target != np.bool_:
                return self._elementwise(lambda x: p.apply("number", x), a)
            case _, np.uint32 if jnp.issubdtype(source, jnp.signedinteger):
                return self._elementwise(self._word, a)
            case _ if np.dtype(np.uint64) in (source, target) or self._unsigned(a):
                raise UnsupportedError(f"whole numbers without sign, converted from {source} to {target}")
        return super()._do_convert_element_type(equation, a)

    def _word(self, x: Value) -> Value:
        constant = self.program.constants.get(x)
        return self.program.apply("word", x) if constant is None else self.program.word(int(constant))

    def _do_bitcast_convert_type(self, equation: Any, a: Values) -> Values:
        source, target = equation.invars[0].aval.dtype, primitives.new_dtype(equation)
        if (source, target) != (np.uint64, np.float64):
            raise UnsupportedError(f"bits of {source} as {target}")
        return self._elementwise(lambda x: self.program.apply("number_of_bits", *self._two(x)), a)

    def _do_erf_inv(self, equation: Any, a: Values) -> Values:
        del equation
        return self._elementwise(self._functions.erf_inv, a)
