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
