"""Records that users hold are shown in a line, and in a notebook as a table."""

import dataclasses

import jax

import glucoloop as gl


def held():
    """Objects of each kind that a user is given."""
    person = gl.patient()
    identified = gl.identify(person)
    record, _ = gl.record_from_samples([0.0, 5.0, 10.0], [22.0, 22.0, 22.0], [80.0, 81.0, 82.0])
    trace = gl.simulate(person, gl.design_open_loop(), scenario=gl.Scenario([gl.Meal(50.0, 10.0)], 60.0))
    yield from (person, gl.patient("hovorka-2004"), gl.patient("kanderian-2009"), gl.population("parker2000"))
    yield from (gl.linear_model(person), gl.nonlinear_model(person), identified, identified.model, record, trace)
    yield from (gl.summarise(trace), gl.Scenario([gl.Meal(50.0, 10.0)], 60.0))


def test_what_a_user_holds_is_shown_in_a_line_and_as_a_table():
    for thing in held():
        line = repr(thing)
        assert line.startswith(f"{type(thing).__name__}(")
        assert len(line) < 600
        assert "\n" not in line
        assert f"<caption>{type(thing).__name__}</caption>" in thing._repr_html_()


def test_an_array_is_named_by_its_type_and_shape():
    model = gl.identify(gl.patient()).model
    assert f"step_response=float64[{model.step_response.size}]" in repr(model)
    assert "sample_time_min=5" in repr(model)


def test_a_table_escapes_what_a_file_may_hold():
    people = gl.patients.Population("<b>", summary="a & b")
    assert "&lt;b&gt;" in people._repr_html_()
    assert "a &amp; b" in people._repr_html_()


def test_a_number_that_is_traced_is_shown_by_its_type():
    person = gl.patient()

    def shown(rate):
        assert "basal_insulin_mU_min=float64[]" in repr(dataclasses.replace(person, basal_insulin_mU_min=rate))
        return rate

    jax.jit(shown)(25.0)
