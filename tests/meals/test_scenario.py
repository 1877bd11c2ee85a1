import numpy as np
import pytest

from glucoloop.meals import HovorkaGut, Ingestion, LehmannDeutsch, Meal, Scenario, appearance_mg_min


@pytest.mark.parametrize("carbs_g", [0.0, -10.0, np.nan, np.inf, 1e9, 1000.1])
def test_an_impossible_meal_is_refused(carbs_g):
    with pytest.raises(ValueError, match=r"^a meal of .* g is not possible; give more than 0 and at most 1000 g$"):
        Meal(carbs_g, 0.0)


@pytest.mark.parametrize("t_min", [-1.0, np.nan, np.inf])
def test_a_meal_at_an_impossible_time_is_refused(t_min):
    with pytest.raises(
        ValueError, match=r"^a meal at .* min is not possible; give a finite time( of 0 min or later)?$"
    ):
        Scenario([Meal(50.0, t_min)])


@pytest.mark.parametrize("eating_min", [-5.0, 0.5, 1441.0, np.nan, np.inf])
def test_an_impossible_time_of_eating_is_refused(eating_min):
    told = r"^a meal eaten over .* min is not possible; give 0 for a meal that is eaten at once, or 1 to 1440 min$"
    with pytest.raises(ValueError, match=told):
        Meal(50.0, 10.0, eating_min)


def test_a_scenario_names_a_meal_model_or_holds_one():
    own = HovorkaGut(time_to_maximum_min=55.0)
    assert Scenario(meal_model=own).absorbed_by(None).model == own
    assert Scenario(meal_model="hovorka").meal_model == HovorkaGut()
    assert Scenario().absorbed_by(None).model == LehmannDeutsch()
    assert Scenario(meal_model="hovorka") == Scenario(meal_model=HovorkaGut())
    with pytest.raises(ValueError, match="unknown meal model 'soup'"):
        Scenario(meal_model="soup")
    with pytest.raises(ValueError, match="bioavailability of 0 is not possible for a meal model"):
        Scenario(meal_model=HovorkaGut(bioavailability=0.0))
    with pytest.raises(TypeError, match="meal_model is 3, which is no meal model; give one, or a name: lehm"):
        Scenario(meal_model=3)


def test_a_patient_that_digests_is_fed_as_it_eats():
    class Digests:
        meal_model = Ingestion()

    meal = Scenario([Meal(30.0, 20.0, 15.0)]).absorbed_by(Digests())
    assert float(appearance_mg_min(25.0, meal)) == 2000.0


@pytest.mark.parametrize("horizon", [0.0, -5.0, np.nan, np.inf, 400 * 1440.0])
def test_an_impossible_horizon_is_refused(horizon):
    with pytest.raises(ValueError, match=r"^a horizon of .* min is not possible; give more than 0 and at most"):
        Scenario([], horizon)


@pytest.mark.parametrize("t_min", [600.0, 601.0])
def test_a_meal_after_the_end_is_refused(t_min):
    with pytest.raises(ValueError, match=r"begins after the run ends at 600 min; move the meal or lengthen the run"):
        Scenario([Meal(50.0, 10.0), Meal(20.0, t_min)], 600.0)


@pytest.mark.parametrize("glucose", [0.0, -1.0, np.nan, np.inf])
def test_an_impossible_glucose_is_refused(glucose):
    with pytest.raises(ValueError, match=r"^a setpoint of .* mg/dl is not possible; give a finite value above 0"):
        Scenario(setpoint_mg_dl=glucose)
    with pytest.raises(ValueError, match=r"^an initial glucose of .* mg/dl is not possible; give a finite"):
        Scenario(initial_glucose_mg_dl=glucose)


def test_a_glucose_that_is_hardly_meant_is_asked_about():
    with pytest.raises(
        ValueError, match=r"^setpoint_mg_dl is 5.5 mg/dl; that looks like mmol/l: 5.5 mmol/l is 99.1 mg"
    ):
        Scenario(setpoint_mg_dl=5.5)
    with pytest.raises(ValueError, match=r"7.8 mmol/l is 141 mg/dl. Give 141, or pass allow_unusual=True if 7.8 mg/dl"):
        Scenario(initial_glucose_mg_dl=7.8)
    assert Scenario(setpoint_mg_dl=5.5, initial_glucose_mg_dl=7.8, allow_unusual=True).setpoint_mg_dl == 5.5


def test_bounds_are_included():
    assert Scenario([Meal(1000.0, 0.0)], 366 * 1440.0).horizon_min == 366 * 1440.0


def test_the_default_is_the_oral_glucose_test():
    scenario = Scenario()
    assert scenario.meals == (Meal(50.0, 50.0),)
    assert scenario.horizon_min == 600.0
    assert float(appearance_mg_min(100.0, scenario.absorbed_by(None))) == pytest.approx(157.00817, rel=1e-7)


def test_meals_are_sorted_and_any_iterable_will_do():
    scenario = Scenario((meal for meal in (Meal(20.0, 300.0), Meal(60.0, 30.0))), 600.0)
    assert [meal.t_min for meal in scenario.meals] == [30.0, 300.0]


def test_a_scenario_without_meals_has_no_appearance():
    assert float(appearance_mg_min(100.0, Scenario([], 60.0).absorbed_by(None))) == 0.0


def test_scenarios_compare_by_content():
    assert Scenario([Meal(20.0, 5.0)], 60.0) == Scenario((Meal(20.0, 5.0),), 60)
    assert hash(Scenario()) == hash(Scenario())
