"""People of a cohort who are stepped from outside, one sample at a time, each at a sample of their own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree
from glucoloop.control.protocol import Decision, Observation, Status
from glucoloop.simulation.engines import Lanes
from glucoloop.sparse import Sparse, dense

Array = npt.NDArray[Any]

MAX_AT_ONCE: Final = 504
"""Largest number of samples of a piece of a run, 42 h of 5 min: the inputs of its people are in memory."""
_FEW: Final = 0.1
"""Share of numbers other than 0 up to which only these are kept, as of meals, of which there are few in a day."""


@dataclass(frozen=True)
class Begun:
    """People before their first sample, people trailing."""

    person: Any
    carry: Any
    key_data: Array
    """(people, ...) data of the random keys of their readings."""
    inputs_in: Callable[[int], Mapping[str, StoredInputs]]
    """Function of the number of a piece of `MAX_AT_ONCE` samples that gives their inputs in it."""
    seen: SeenAtSample
    samples: int


@dataclass(frozen=True)
class SeenAtSample:
    """Glucose, reading and insulin of people at a sample, ``(people,)`` each."""

    glucose_mg_dl: Array
    """Glucose, free of noise."""
    reading_mg_dl: Array
    """Reading of the sensor, NaN where there is none."""
    infused_mU_min: Array
    """All insulin since the last sample, as a rate."""


class StoredInputs:
    """Inputs of people ``(samples, ..., people)``, kept in little memory."""

    def __init__(self, given: Array | Sparse) -> None:
        values = dense(given)
        self._shape = values.shape[1:]
        shared = 0 in values.strides  # the same for all, and in memory only once
        self._dense = values if shared or np.count_nonzero(values) > _FEW * values.size else None
        if self._dense is None:
            flat = values.reshape(len(values), -1)
            sample, self._place = np.nonzero(flat)
            self._numbers = flat[sample, self._place]
            self._edges = np.searchsorted(sample, np.arange(len(values) + 1))

    def at(self, sample: int) -> Array:
        """Inputs of a sample, ``(..., people)``."""
        if self._dense is not None:
            return np.asarray(self._dense[sample])
        values = np.zeros(self._shape)
        of_sample = slice(self._edges[sample], self._edges[sample + 1])
        values.reshape(-1)[self._place[of_sample]] = self._numbers[of_sample]
        return values


class _Group:
    """People who began together, and so are at the same sample."""

    def __init__(self, begun: Begun, columns: npt.NDArray[np.intp], lanes: npt.NDArray[np.intp]) -> None:
        self._begun, self._columns, self.lanes, self._sample = begun, columns, lanes, 0

    def without(self, ended: npt.NDArray[np.bool_]) -> bool:
        """Leave lanes out; whether any are left."""
        stays = ~ended[self.lanes]
        if not stays.all():
            self._columns, self.lanes = self._columns[stays], self.lanes[stays]
        return bool(self.lanes.size)

    def next_inputs(self) -> dict[str, Array]:
        """Inputs of the coming sample, ``(..., lanes)``; after the last sample those of the last."""
        piece, sample = divmod(min(self._sample, self._begun.samples - 1), MAX_AT_ONCE)
        self._sample += 1
        return {name: of.at(sample)[..., self._columns] for name, of in self._begun.inputs_in(piece).items()}


class SteppedPeople:
    """Places for a number of people of a cohort, in each of which one person goes from sample to sample.

    See `Cohort.lanes`.
    """

    def __init__(self, lanes: Lanes, number: int) -> None:
        self._lanes, self.number = lanes, number
        self._groups: list[_Group] = []
        self._key_data: Array | None = None
        self._reaching: dict[str, Array] = {}
        self.sample = np.zeros(number, np.int64)
        """(lanes,) number of the coming sample."""
        self.seen = SeenAtSample(*(np.full(number, np.nan) for _ in range(3)))

    @property
    def reported_mU_min(self) -> Array:
        """(lanes,) rate that the pump reports."""
        return np.asarray(self._lanes.carry.loop.reported_mU_min)

    @property
    def reported_bolus_mU(self) -> Array | None:
        """(lanes,) bolus that the pump reports, or None where there are none."""
        bolus = self._lanes.carry.loop.reported_bolus_mU
        return None if bolus is None else np.asarray(bolus)

    def begin(self, begun: Begun, columns: npt.NDArray[np.intp], lanes: npt.NDArray[np.intp]) -> None:
        """Put people, by their columns, in the place of those of some lanes."""

        def put(to: Array, of: Any) -> None:
            to[..., lanes] = np.asarray(of)[..., columns]

        jax.tree.map(put, (self._lanes.person, self._lanes.carry), (begun.person, begun.carry))
        if self._key_data is None:
            self._key_data = np.zeros((self.number, *begun.key_data.shape[1:]), begun.key_data.dtype)
        self._key_data[lanes] = begun.key_data[columns]
        ended = np.zeros(self.number, bool)
        ended[lanes] = True
        self._groups = [group for group in self._groups if group.without(ended)]
        self._groups.append(_Group(begun, columns, lanes))
        self.sample[lanes] = 0
        for name, values in vars(self.seen).items():
            values[lanes] = getattr(begun.seen, name)[columns]

    def step(
        self,
        insulin_mU_min: Array,
        bolus_mU: Array | None = None,
        glucagon_ug: Array | None = None,
        *,
        threads: int = 1,
    ) -> None:
        """Carry everybody to the next sample, under rates, boluses and glucagon ``(lanes,)`` where they are given."""
        requested = [dose for dose in (insulin_mU_min, bolus_mU, glucagon_ug) if dose is not None]
        for group in self._groups:
            for name, values in group.next_inputs().items():
                if name not in self._reaching:
                    self._reaching[name] = np.zeros((*values.shape[:-1], self.number))
                self._reaching[name][..., group.lanes] = values
        assert self._key_data is not None
        outputs = self._lanes.step({**self._reaching, "asked": requested}, self._key_data, self.sample, threads=threads)
        self.sample += 1
        for to, new in zip(vars(self.seen).values(), outputs, strict=True):
            np.copyto(to, new)


@pytree
class ExternalDoses:
    """Controller whose doses are numbers of its own, which are set before each sample; it has no memory."""

    insulin_mU_min: jax.Array
    bolus_mU: jax.Array | None
    """Bolus, or None where the pump can give none."""
    glucagon_ug: jax.Array | None = None
    """Glucagon until the next sample, or None where none is given."""
    sample_time_min: float

    heals: ClassVar = True

    @property
    def gives_boluses(self) -> bool:
        """Whether the pump can give boluses."""
        return self.bolus_mU is not None

    @property
    def gives_glucagon(self) -> bool:
        """Whether glucagon is given."""
        return self.glucagon_ug is not None

    def init(self, observation: Observation) -> tuple[()]:
        """State without memory."""
        del observation
        return ()

    def step(self, state: tuple[()], observation: Observation) -> tuple[tuple[()], Decision]:
        """Decision with the dose from outside."""
        del observation
        status = jnp.asarray(int(Status.OK))
        return state, Decision(
            insulin_mU_min=self.insulin_mU_min, status=status, bolus_mU=self.bolus_mU, glucagon_ug=self.glucagon_ug
        )
