"""The tables of the study of measured machines, from diagnoses that are made up."""

from dropo.studies.measured.study import _causes, _left_out


def test_causes_name_what_they_are_confused_with():
    """Each of the others once, with its place where it has one."""
    others = [
        {"effect": "joint_friction", "target": "j1"},
        {"effect": "air_drag", "target": None},
        {"effect": "joint_friction", "target": "j1"},
    ]
    causes = [
        {"held_out_gain": 0.25, "confused_with": others, "acts_like": "speed"},
        {"held_out_gain": 0.5, "confused_with": [], "acts_like": None},
    ]
    result = {"problem": "double-pendulum", "causes": causes, "sentences": ["one", "two"]}
    assert _causes(result) == [
        ("double-pendulum", "one", "0.25", "joint_friction:j1, air_drag", "speed"),
        ("double-pendulum", "two", "0.5", "-", "-"),
    ]


def test_spans_that_are_left_out_are_listed():
    """With their run and time, and the errors with them, "-" where there are none; nothing where
    nothing was looked for.
    """
    spans = [
        {"run": "a", "from": 0.5, "to": 0.75, "held_out": True},
        {"run": "b", "from": 1.0, "to": 2.0, "held_out": False},
    ]
    found = {
        "spans": spans,
        "share": 0.031,
        "errors_with_them": {"baseline": {"units": {"rad": {"rmse": 0.0123}}}, "extended": None},
    }
    result = {"problem": "simple-pendulum", "disturbances": found}
    assert _left_out(result) == [
        (
            "simple-pendulum",
            "3.1%",
            "held-out run a: 0.50 to 0.75; run b: 1.00 to 2.00",
            "12.3 mrad",
            "-",
        )
    ]
    assert _left_out(result | {"disturbances": None}) == []
