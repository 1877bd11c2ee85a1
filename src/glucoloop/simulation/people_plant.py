"""The exponential integrator for people whose constants differ.

The exponentials of the slow block are those of the nominal patient without its slow couplings, and so the same for all;
what differs in a person enters with the nonlinear part, at the same order. Insulin has matrices of the person's own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.native.targets.products import FUSED
from glucoloop.patients.protocol import SemilinearPatient
from glucoloop.refusal import Refusal
from glucoloop.simulation import driven_block
from glucoloop.simulation.exponential import (
    ExponentialPlant,
    Matrices,
    design,
    substeps_for,
    substeps_of,
    working_state,
)
from glucoloop.simulation.per_person_leaves import varying
from glucoloop.simulation.plant import SampleGrid
from glucoloop.simulation.user_objects import compiled_by_class, refuse_two_patients

PER_NOMINAL: Final = 2
"""Steps of the people's exponential integrator for each that the nominal patient needs."""


class PeoplePlant:
    """Plants of people of one kind, with an integrator that is made about the nominal patient.

    `varied` are some people, to show which constants vary: those that have one axis more than the nominal patient's.
    Products are rounded in the matrices of people as `glucoloop.native.targets.products` says.
    """

    def __init__(
        self,
        nominal: SemilinearPatient,
        varied: SemilinearPatient,
        grid: SampleGrid,
        substeps: int | None = None,
        products: str = FUSED,
    ) -> None:
        refuse_two_patients(nominal)
        self._products = products
        self.substeps = PER_NOMINAL * substeps_for(grid.sample_time_min) if substeps is None else substeps
        self.step_min, dense = substeps_of(grid, self.substeps)
        state = working_state(nominal)
        matrices = design(nominal, self.step_min, dense, state, nominal.stiff_couplings())
        patient_varies = varying(varied, nominal)
        y, z = nominal.split(state)
        if _depends(lambda p: p.transport(y), nominal, patient_varies):
            matrices = dataclasses.replace(matrices, transport=_transport(nominal, y))
        if _depends(lambda p: p.glucose_mg_dl(p.join(y, z)), nominal, patient_varies):
            matrices = dataclasses.replace(matrices, probe=_probe(nominal, varied))
        self._driven_varies = _depends(lambda p: p.driven_derivative(z, jnp.zeros(())), nominal, patient_varies)
        self._doublings = driven_block.doublings_for(nominal, self.step_min)
        self.single = ExponentialPlant(patient=nominal, matrices=matrices)
        self.varies = [*patient_varies, *self._matrices_vary()]

    def _matrices_vary(self) -> list[bool]:
        varies: list[bool] = []
        for field in dataclasses.fields(Matrices):
            numbers = len(jax.tree.leaves(getattr(self.single.matrices, field.name)))
            varies += [self._driven_varies and field.name.startswith("driven")] * numbers
        return varies

    def of(self, patient: SemilinearPatient) -> ExponentialPlant:
        """Plants of people, numbers trailing."""
        matrices = self.single.matrices
        if self._driven_varies:
            end, gauss = driven_block.driven_matrices(
                patient,
                self.step_min,
                states=matrices.driven_end.shape[0],
                doublings=self._doublings,
                products=self._products,
            )
            matrices = dataclasses.replace(matrices, driven_end=jnp.asarray(end), driven_gauss=jnp.asarray(gauss))
        return ExponentialPlant(patient=patient, matrices=matrices)


@compiled_by_class
def _transport(patient: SemilinearPatient, y: jax.Array) -> jax.Array:
    matrix: jax.Array = jax.jacfwd(patient.transport)(y)
    return matrix


def _probe(nominal: SemilinearPatient, varied: SemilinearPatient) -> jax.Array:
    """Slow block at which the nominal patient's glucose is 1 mg/dl; other people's glucose there is their scale.

    Refused if their glucose is not proportional to the nominal patient's in every state: readings inside a step would
    then be wrong.
    """
    y, z = nominal.split(working_state(nominal))
    blocks = np.eye(y.size)
    row = np.array([float(nominal.glucose_mg_dl(nominal.join(jnp.asarray(block), 0.0 * z))) for block in blocks])
    probe = row / (row @ row)
    people = np.shape(varied.basal_insulin_mU_min)

    def read(block: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        slow = jnp.broadcast_to(jnp.asarray(block).reshape(-1, *[1] * len(people)), (block.size, *people))
        glucose = varied.glucose_mg_dl(varied.join(slow, jnp.zeros((z.size, *people))))
        return np.broadcast_to(np.asarray(glucose, float), people)

    scale = read(probe)
    for block, of_nominal in zip(blocks, row, strict=True):
        if not np.allclose(read(block), of_nominal * scale, rtol=1e-9, atol=0.0):
            raise Refusal(
                "glucose of these people is not in proportion to that of the nominal patient in the same state, so it "
                "cannot be read between samples; write the patient's slow block as concentrations"
            )
    return jnp.asarray(probe)


def _depends(function: Callable[[Any], jax.Array], single: Any, varies: Sequence[bool]) -> bool:
    """Whether a function of a person depends on any of the varying leaves."""
    leaves, tree = jax.tree.flatten(single)
    jaxpr = jax.make_jaxpr(lambda *leaves: function(jax.tree.unflatten(tree, leaves)))(*leaves).jaxpr
    used = {id(atom) for equation in jaxpr.eqns for atom in equation.invars}
    return any(differs and id(variable) in used for differs, variable in zip(varies, jaxpr.invars, strict=True))
