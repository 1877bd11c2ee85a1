import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop import units


def test_glucose_in_mmol_per_litre():
    # C6H12O6: 6 x 12.011 + 12 x 1.008 + 6 x 15.999 g/mol; 1 dl is a tenth of a litre
    molar_mass = 6 * 12.011 + 12 * 1.008 + 6 * 15.999
    assert units.mmol_l_from_mg_dl(100.0) == pytest.approx(1000.0 / molar_mass, rel=1e-5)
    assert units.mg_dl_from_mmol_l(10.0) == pytest.approx(180.156, rel=1e-12)
    assert units.mg_dl_from_mmol_l(units.mmol_l_from_mg_dl(81.1)) == pytest.approx(81.1, rel=1e-15)


def test_insulin_rates():
    assert units.u_h_from_mu_min(22.33) == pytest.approx(1.3398, rel=1e-12)
    assert units.mu_min_from_u_h(1.0) == pytest.approx(1000.0 / 60.0, rel=1e-15)
    assert units.mu_min_from_u_h(units.u_h_from_mu_min(25.606)) == pytest.approx(25.606, rel=1e-15)


def test_one_unit_of_insulin_is_six_nmol():
    assert units.PMOL_PER_U == 6000.0
    assert units.MU_PER_U == 1000.0
    assert units.MIN_PER_DAY == 24 * units.MIN_PER_H


def test_arrays_are_converted_as_numbers_are():
    for there, back in (
        (units.mmol_l_from_mg_dl, units.mg_dl_from_mmol_l),
        (units.u_h_from_mu_min, units.mu_min_from_u_h),
    ):
        for values in (np.array([1.0, 81.1]), jnp.array([1.0, 81.1])):
            assert type(there(values)) is type(values)
            np.testing.assert_allclose(back(there(values)), values, rtol=1e-15)
            assert there(values)[1] == pytest.approx(there(81.1), rel=1e-15)


def test_the_table_of_units_agrees_with_the_functions():
    assert units.factor_to("mg/dl", "mmol/l") == units.mg_dl_from_mmol_l(1.0)
    assert units.factor_to("mU/min", "U/h") == pytest.approx(units.mu_min_from_u_h(1.0), rel=1e-15)
    assert units.factor_to("mU/min", "pmol/min") == 1.0 / 6.0
    for unit in units.OTHER_UNITS:
        assert unit in {*units.UNIT_BY_ENDING.values(), "(mg/dl)²", "mU/min per mg/dl"}
