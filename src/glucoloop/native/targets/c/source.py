"""A pair of functions, init and step, as one C file and its header."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax
import numpy as np
import numpy.typing as npt

from glucoloop.native.functions import DOUBLE
from glucoloop.native.lower import Lowered, lower
from glucoloop.native.targets.c.compact.translate import Body, compact
from glucoloop.native.targets.c.compact.writer import WORKSPACE, Tables
from glucoloop.native.targets.c.numbers import FORMATS, TRUTH, WHOLE, Format, helpers, kind_of, template, type_of
from glucoloop.native.targets.c.records import Structure, declaration, record
from glucoloop.native.targets.c.unrolled import elementary, unrolled
from glucoloop.refusal import Refusal

MEANINGS: Final = {
    "observation": {
        "glucose_mg_dl": "reading of the sensor [mg/dl]; any bits where it is not valid",
        "valid": "0: the sensor has no valid reading, otherwise: it has",
        "setpoint_mg_dl": "target glucose [mg/dl]",
        "delivered_mU_min": "rate that the pump delivered since the last step [mU/min]",
        "announced_carbs_g": "carbohydrate of a meal that begins before the next step [g]; 0: none announced",
        "announced_in_min": "time from now until that meal is eaten [min]; 0: before the next step",
        "delivered_bolus_mU": "bolus that the pump delivered since the last step, apart from that rate [mU]; 0: none",
        "time_of_day_min": "minutes after midnight, from 0 to below 1440 [min]",
    },
    "decision": {
        "insulin_mU_min": "rate until the next step [mU/min]",
        "bolus_mU": "bolus, beside that rate [mU]; 0: none",
        "glucagon_ug": "glucagon by the second route until the next step [ug]; 0: none",
        "status": "number of a status; 0: normal",
    },
}
"""Meanings of the fields of an observation and of a decision."""
_AROUND: Final = 20
"""Number of bytes of a record around the state: mark, digest and CRC."""


def _record_bytes(state_bytes: int) -> int:
    """Number of bytes of a saved state."""
    return state_bytes + _AROUND


def _header(structures: str, state_bytes: int) -> str:
    """The header around the structures."""
    return template("header.h").replace("@STRUCTURES@", structures).replace("@SIZE@", str(_record_bytes(state_bytes)))


def _saving(state_bytes: int, design: str) -> str:
    """``gl_save`` and ``gl_restore``, for a design with a digest."""
    mark = ["47", "4C", "53", "54", *(design[i : i + 2].upper() for i in range(0, 24, 2))]
    text = "\n" + template("saving.c").replace("@MARK@", ", ".join(f"0x{byte}U" for byte in mark))
    return text.replace("@SIZE@", str(state_bytes))


UNROLLED: Final = "unrolled"
COMPACT: Final = "compact"
AUTO: Final = "auto"
_LONGEST_UNROLLED: Final = 1000
"""Largest number of operations of a step for which `auto` takes the unrolled form, which is faster but larger."""
HEADER: Final = "controller.h"


@dataclass(frozen=True)
class Traced:
    """A controller's functions, traced in one precision."""

    init: Any
    """ClosedJaxpr: observation -> state."""
    step: Any
    """ClosedJaxpr: state, observation -> state, decision."""
    state: Any
    observation: Any
    decision: Any
    """Trees of shapes of the decision."""
    functions: tuple[Callable[..., Any], Callable[..., Any]]
    precision: str


@dataclass(frozen=True)
class LastClamp:
    """Bounds of doses that the step keeps already, and that C applies once more, so that tools can prove them."""

    rate: str
    """Field of the decision."""
    delivered: str
    """Field of the observation: the rate so far."""
    minimum: float
    maximum: float
    change: float
    """Largest change from a delivered rate that is within the bounds, with all rounding of the step."""
    amounts: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Largest amount by its field of the decision, where there is a bolus or glucagon."""

    def lines(self, format: Format) -> list[str]:
        """Last statements of the step."""
        place = f"decision->{self.rate}"
        doses = [(place, f"gl_limited({place}, observation->{self.delivered})", self.minimum)]
        for name, largest in self.amounts.items():
            place = f"decision->{name}"
            doses.append((place, f"gl_clip({place}, {format.literal(0.0)}, {format.literal(largest)})", 0.0))
        # Frama-C concludes that a number is one from x == x alone, not from a comparison with a bound.
        return [
            line
            for place, bounded, minimum in doses
            for line in (
                f"{place} = {bounded};",
                f"{place} = ({place} == {place}) ? {place} : {format.literal(minimum)};",
            )
        ]

    def function(self, format: Format) -> list[str]:
        """Definition of the function that is called."""
        real, low, high, change = format.type, *map(format.literal, (self.minimum, self.maximum, self.change))
        lines = [
            "/* The rate within the limits of the pump, which the step keeps: once more, so that it can be proved. */",
            f"static {real} gl_limited({real} rate, {real} delivered)",
            "{",
            f"const {real} near = gl_inside(delivered, {low}, {high}) ? "
            f"gl_clip(rate, delivered - {change}, delivered + {change}) : rate;",
            f"return gl_clip(near, {low}, {high});",
            "}",
            "",
        ]
        return _indented(lines)


@dataclass(frozen=True)
class Source:
    """A controller in C."""

    header: str
    code: str
    form: str
    records: dict[str, Structure]
    """The structures by name: state, observation and decision."""
    workspace: dict[str, int]
    """Count of numbers of each kind in the workspace."""
    lowered: tuple[Lowered, Lowered] | None
    """Init and step as scalar programs; None in the compact form."""
    design: str
    """SHA-256 of the statements and of the structures, without comments; it distinguishes saved states."""
    record_bytes: int
    """Size of a saved state."""


def trace(init: Callable[[Any], Any], step: Callable[[Any, Any], Any], observation: Any, precision: str) -> Traced:
    """Trace ``state = init(observation)`` and ``state, decision = step(state, observation)`` in a precision.

    The numbers of both functions already have that precision.
    """
    with jax.enable_x64(precision == DOUBLE):
        first, state = jax.make_jaxpr(init, return_shape=True)(observation)
        each, (after, decision) = jax.make_jaxpr(step, return_shape=True)(state, observation)
    before, then = ([(x.shape, x.dtype) for x in jax.tree.leaves(tree)] for tree in (state, after))
    if before != then:
        raise TypeError(f"the state has leaves {before} before a sample, but {then} after it")
    return Traced(
        init=first,
        step=each,
        state=state,
        observation=observation,
        decision=decision,
        functions=(init, step),
        precision=precision,
    )


def write_source(traced: Traced, title: Sequence[str], form: str = AUTO, last: LastClamp | None = None) -> Source:
    """Write a controller in C, with a title at the head of its files, in the form auto, unrolled or compact."""
    if form not in (AUTO, UNROLLED, COMPACT):
        raise Refusal(f"the form is {form!r}; the known ones are: {AUTO}, {UNROLLED}, {COMPACT}")
    format, tables = FORMATS[traced.precision], Tables()
    state, observation = record("state", traced.state), record("observation", traced.observation)
    decision = record("decision", traced.decision)
    lowered = None if form == COMPACT else _lowered(traced, form)
    with jax.enable_x64(traced.precision == DOUBLE):
        if lowered is None:
            form = COMPACT
            bodies = [
                compact(traced.init, [observation], [state], traced.precision, tables),
                compact(traced.step, [state, observation], [state, decision], traced.precision, tables),
            ]
        else:
            form = UNROLLED
            of_state, of_observation, of_decision = (
                structure.elements() for structure in (state, observation, decision)
            )
            lines = [
                unrolled(lowered[0], of_observation, of_state),
                unrolled(lowered[1], [*of_state, *of_observation], [*of_state, *of_decision]),
            ]
            bodies = [Body(of_function, {}) for of_function in lines]
        if last is not None:
            bodies[1] = Body([*bodies[1].lines, *last.lines(format)], bodies[1].workspace)
        code = _code(bodies, tables, format, [] if last is None else last.function(format))
    workspace = {kind: max(body.workspace.get(kind, 0) for body in bodies) for kind in WORKSPACE}
    records = {"state": state, "observation": observation, "decision": decision}
    statements = _without_comments("\n".join([_structures(records, workspace, format), *code]))
    design = hashlib.sha256(statements.encode()).hexdigest()
    size = state.memory(traced.precision).itemsize
    head = [
        "/*",
        *(f" * {line}".rstrip() for line in title),
        f" * Design {design[:16]}, {form} form, {format.type}.",
        " */",
    ]
    return Source(
        header="\n".join([*head, _header(_structures(records, workspace, format, MEANINGS), size)]),
        code="\n".join([*head, *_before(format), *code, _saving(size, design)]),
        form=form,
        records=records,
        workspace=workspace,
        lowered=lowered,
        design=design,
        record_bytes=_record_bytes(size),
    )


def _lowered(traced: Traced, form: str) -> tuple[Lowered, Lowered] | None:
    """Both functions as scalar programs; None where `auto` finds them too long or unsupported."""
    init, step = traced.functions
    precision = traced.precision

    def first(person: Any, carry: Any, own: Any, shared: Any, chance: Any) -> Any:
        del person, shared, chance
        return carry, init(own)

    def each(person: Any, carry: Any, own: Any, shared: Any, chance: Any) -> Any:
        del person, shared, chance
        return step(carry, own)

    loops = {"scan", "while", "lu"} & {equation.primitive.name for equation in _equations(traced.step.jaxpr)}
    if form == AUTO and loops:
        return None
    with jax.enable_x64(precision == DOUBLE):
        stepping = lower(each, (), traced.state, traced.observation, (), precision=precision)
        if form == AUTO and len(stepping.program.needed(stepping.layout.results)) > _LONGEST_UNROLLED:
            return None
        return lower(first, (), (), traced.observation, (), precision=precision), stepping


def _equations(jaxpr: Any) -> Iterator[Any]:
    """All equations, those of functions inside as well."""
    for equation in jaxpr.eqns:
        yield equation
        for parameter in equation.params.values():
            for part in parameter if isinstance(parameter, tuple | list) else (parameter,):
                inner = getattr(part, "jaxpr", part)
                if hasattr(inner, "eqns"):
                    yield from _equations(inner)


def _without_comments(code: str) -> str:
    return re.sub(r"\s*/\*.*?\*/", "", code, flags=re.DOTALL)


def _before(format: Format) -> list[str]:
    allowed = "(FLT_EVAL_METHOD != 0)" if format.type == "float" else "(FLT_EVAL_METHOD != 0) && (FLT_EVAL_METHOD != 1)"
    return template("before.c").replace("@HEADER@", HEADER).replace("@DIGITS@", allowed).split("\n")


def _code(bodies: Sequence[Body], tables: Tables, format: Format, last: Sequence[str]) -> list[str]:
    first, each = (_function(name, body, format) for name, body in zip(("gl_init", "gl_step"), bodies, strict=True))
    functions = elementary([*first, *each], format)
    return [
        *_tables(tables, "\n".join([*first, *each]), format),
        *helpers([*functions, *last, *first, *each], format),
        *_indented(functions),
        *last,
        *first,
        "",
        *each,
        "",
    ]


def _function(name: str, body: Body, format: Format) -> list[str]:
    parameters = ["gl_workspace *workspace", "gl_state *state", "const gl_observation *observation"]
    if name == "gl_step":
        parameters.append("gl_decision *decision")
    lines = list(body.lines)
    text = "\n".join(lines)
    for pointer in ("state", "observation", "decision"):
        if f"{pointer}->" not in text and any(pointer in parameter for parameter in parameters):
            lines.insert(0, f"(void){pointer};")
    used = [(type_of(kind, format), letter) for kind, letter in WORKSPACE.items() if body.workspace.get(kind)]
    locals_ = [f"{type_name} *const {letter} = workspace->{letter};" for type_name, letter in used]
    locals_ = locals_ or ["(void)workspace;"]
    return _indented([f"void {name}({', '.join(parameters)})", "{", *locals_, *lines, "}"])


def _indented(lines: Sequence[str]) -> list[str]:
    """Lines with the indentation of their depth."""
    indented, depth = [], 0
    for line in lines:
        if line.startswith("}"):
            depth -= 1
        indented.append("  " * depth + line if line else line)
        if line == "{":
            depth += 1
    return indented


def _tables(tables: Tables, text: str, format: Format) -> list[str]:
    """The tables that a text reads."""
    lines: list[str] = []
    for name, array in tables.arrays.items():
        if f"{name}[" not in text:
            continue
        kind = kind_of(array.dtype)
        small = kind == WHOLE and array.min() >= -(2**15) and array.max() < 2**15
        type_name = "int16_t" if small else type_of(kind, format)
        lines += [f"static const {type_name} {name}[{array.size}] =", "{", *_rows(array, kind, format), "};", ""]
    return lines


def _rows(array: npt.NDArray[np.generic], kind: str, format: Format) -> list[str]:
    texts = [format.constant(number, kind) for number in array.tolist()]
    return [f"  {', '.join(texts[i : i + 6])}{',' if i + 6 < len(texts) else ''}" for i in range(0, len(texts), 6)]


def _structures(
    records: dict[str, Structure],
    workspace: dict[str, int],
    format: Format,
    meanings: Mapping[str, Mapping[str, str]] | None = None,
) -> str:
    comments = {
        "observation": "Inputs of a step.",
        "state": "State of the controller between samples. The caller keeps it.",
        "decision": "Dose until the next sample, and its status.",
    }
    lines: list[str] = []
    for name, comment in comments.items():
        of_fields = None if meanings is None else meanings.get(name)
        lines += [*declaration(f"gl_{name}", records[name], format, comment, of_fields), ""]
    room = [
        f"  {type_of(kind, format)} {letter}[{max(1, workspace[kind])}];"
        for kind, letter in WORKSPACE.items()
        if workspace[kind] or (kind == TRUTH and not any(workspace.values()))
    ]
    room_comment = (
        "Working memory of one step, whose content need not be kept. One may serve several controllers in turn."
    )
    return "\n".join([*lines, f"/* {room_comment} */", "typedef struct", "{", *room, "} gl_workspace;"])
