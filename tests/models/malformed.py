"""A problem file and a mapping, to be broken."""

from typing import Any

PROBLEM: dict[str, Any] = {
    "model": "robot.xml",
    "frame_skip": 2,
    "data": "data.npz",
    "input": "commanded",
    "observation": ["qpos[:2]", "qvel[:2]"],
    "action": ["ctrl"],
    "parameters": {
        "mass": {
            "field": "body_mass",
            "name": "cart",
            "low": 1,
            "high": 4,
            "unit": "kg",
            "prior": "normal(2, 0.5)",
        },
        "box": {
            "field": "geom_friction",
            "name": "box",
            "index": 0,
            "low": 0.5,
            "high": 2.0,
            "target": "relative",
            "derived": "keep",
        },
    },
    "lambda": 3,
    "epsilon": {"qpos.slide": 1e-6, "qpos.hinge": 1e-6, "qvel.slide": 1e-4, "qvel.hinge": 1e-4},
    "start_noise": True,
    "student_t": 8,
    "reset": {"set": ["qpos[:2]"]},
    "held_out": [2],
    "transitions": 15,
    "effects": [
        {"effect": "joint_friction", "target": "hinge", "fit": {"frictionloss": [0, 0.1]}},
        {"effect": "actuator_delay", "target": "push", "sizes": {"delay": 0.01}},
    ],
    "motors": {"hinge": {"gear_ratio": 6, "rotor_inertia": 1e-5}, "slide": "ak80-6"},
    "task": {"reward": "task.py:reward", "steps": 20, "bonus": 1.0},
}
MAPPING: dict[str, Any] = {
    "time": {"column": "t", "unit": "ms", "topic": "joints"},
    "qpos": {
        "slide": {"column": "x", "unit": "mm", "sign": -1, "offset": 0.5},
        "cube": {
            "columns": ["p[0:3]", "q[0:4]"],
            "unit": ["mm"],
            "sign": [1, 1, 1, 1, 1, 1, 1],
            "offset": 0,
        },
    },
    "qvel": {
        "slide": {"column": "v", "file": "{stem}_v.csv", "clock": {"column": "t2", "unit": "us"}}
    },
    "inputs": {
        "commanded": {"push": {"column": "u", "unit": "N"}},
        "current": {"push": {"column": "i", "unit": "A"}},
    },
    "run": {"column": "run", "only": ["a*"]},
    "rate": 250,
}
