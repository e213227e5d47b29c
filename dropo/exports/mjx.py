"""The targets `mjx` and `playground`: a randomization function for batches of models in JAX."""

from collections import defaultdict
from typing import Any

from dropo._version import __version__
from dropo.exports.support.distribution import REDRAWS, FittedDistribution
from dropo.exports.support.subject import (
    NO_SPREAD,
    DrawnNumber,
    Subject,
    Written,
    effects_left_out,
    others_left_out,
    remarks_of,
)

HEADER = '''"""Parameters drawn from what was fitted, for MuJoCo Playground and MJX.

    import domain_randomize                       # this file
    fn = domain_randomize.domain_randomize        # (model, rng) -> (model, in_axes)
    functools.partial(fn, rng=jax.random.split(key, num_envs))       # what wrappers take
    ppo.train(..., randomization_fn=fn)                              # what trainers take

`model` is an mjx.Model; `rng` has a key for each environment. Elements are found by their names, so
that the model may have more than the one that was fitted, which is in model.xml at its means.
Masses of subtrees follow; other constants that MuJoCo derives (inverse weights) are those of the
model given. The spread holds what was fitted and what is not known of the means.
Written by dropo {version} from {name!r}.
{remarks}"""

'''
CODE = '''import jax
import jax.numpy as jp
import mujoco
import numpy as np
from mujoco import mjx

NAMES = {names}
KIND = {kind!r}
LOGARITHMIC = {logarithmic}
CENTRE = np.array({centre})
FACTOR = np.array({factor})
ERROR = np.array({error})
LOWER = np.array({lower})
UPPER = np.array({upper})
TOGETHER = {together}
MEAN = np.array({mean})
REDRAWS = {redraws}
# field: (kind of element, its name, places in its row, number at MEAN, change with a parameter)
NUMBERS = {{
{numbers}}}


def draw(key):
    """One parameter vector, in the order of NAMES."""
    keys = jax.random.split(key, REDRAWS + 2)
    values = attempt(keys[0])
    for again in keys[1:-1]:
        bad = (values < LOWER) | (values > UPPER)
        bad = bad | bad.any() if TOGETHER else bad
        values = jp.where(bad, attempt(again), values)
    values = jp.clip(values, LOWER, UPPER)
    values = values + ERROR * jax.random.normal(keys[-1], (len(NAMES),))
    return jp.clip(values, LOWER, UPPER)


def attempt(key):
    """A draw that may be impossible."""
    shape = (len(NAMES),)
    if KIND == "uniform":
        parts = jax.random.uniform(key, shape, minval=-1.0, maxval=1.0)
    elif KIND == "normal":
        parts = jax.random.normal(key, shape)
    else:
        parts = jax.random.truncated_normal(key, -2.0, 2.0, shape)
    values = CENTRE + FACTOR @ parts
    return jp.exp(values) if LOGARITHMIC else values


def place_of(model, field, kind, name, row):
    """Where in a field an element's number is."""
    if kind is None:
        return row
    number = mjx.name2id(model, getattr(mujoco.mjtObj, "mjOBJ_" + kind.upper()), name)
    if number < 0:
        raise ValueError(f"The model has no {{kind}} {{name!r}}, whose {{field}} was fitted.")
    if field.startswith("dof_"):
        number = int(model.jnt_dofadr[number])
    return (number + row[0], *row[1:])


def field_of(model, key):
    """A field by its name."""
    owner = model.opt if key.startswith("opt.") else model
    return getattr(owner, key.removeprefix("opt."))


def set_numbers(model, values):
    """The fields that one parameter vector changes."""
    changed = {{}}
    for field, numbers in NUMBERS.items():
        array = jp.asarray(field_of(model, field))
        for kind, name, row, mean, slopes in numbers:
            number = mean + jp.asarray(slopes) @ (values - MEAN)
            array = array.at[place_of(model, field, kind, name, row)].set(number)
        changed[field] = array
    if "body_mass" in changed:
        more = changed["body_mass"] - model.body_mass
        whole = jp.asarray(model.body_subtreemass)
        for body in range(model.nbody):
            above = body
            while True:
                whole = whole.at[above].add(more[body])
                if above == 0:
                    break
                above = int(model.body_parentid[above])
        changed["body_subtreemass"] = whole
    return changed


def domain_randomize(model, rng):
    """Models with parameters of their own, and which of their fields have an axis for these."""
    values = jax.vmap(draw)(rng)
    changed = jax.vmap(lambda one: set_numbers(model, one))(values)
    in_axes = jax.tree_util.tree_map(lambda _: None, model)
    in_axes = in_axes.tree_replace({{field: 0 for field in changed}})
    return model.tree_replace(changed), in_axes
'''


def mjx(subject: Subject) -> Written:
    """A function domain_randomize(model, rng) for MuJoCo Playground, and for batches in MJX.

    Parameters
    ----------
    subject : Subject
        The robot at its means; the function is written only where it has a distribution.

    Returns
    -------
    Written
        The file domain_randomize.py and the MJCF at the means, with the effects that are no numbers
        of a model among `left_out`.
    """
    left_out = effects_left_out(subject.around, "the function sets numbers of a model alone")
    if subject.distribution is None:
        return Written({}, (*left_out, NO_SPREAD), (), subject.older_xml)
    numbers, others = subject.probed
    left_out += others_left_out(subject, others)
    remarks = remarks_of(left_out, subject.approximated)
    header = HEADER.format(version=__version__, name=subject.name, remarks=remarks)
    text = header + _code(subject, subject.distribution, numbers)
    files: dict[str, str | bytes] = {"domain_randomize.py": text}
    return Written(files, tuple(left_out), subject.approximated, subject.older_xml)


def _code(subject: Subject, distribution: FittedDistribution, numbers: list[DrawnNumber]) -> str:
    """The functions, with the numbers of the distribution."""
    return CODE.format(
        names=distribution.names,
        kind=distribution.kind,
        logarithmic=distribution.logarithmic,
        centre=_list(distribution.centre),
        factor=_list(distribution.factor),
        error=_list(distribution.error),
        lower=_list(distribution.lower),
        upper=_list(distribution.upper),
        together=distribution.together,
        mean=_list(subject.values),
        redraws=REDRAWS,
        numbers=_table(subject, distribution, numbers),
    )


def _list(array: Any) -> str:
    """An array as nested lists; infinite bounds are NumPy's."""
    return repr(array.tolist()).replace("inf", "np.inf")


def _table(subject: Subject, distribution: FittedDistribution, numbers: list[DrawnNumber]) -> str:
    """The entries of NUMBERS: all parameters of a number together."""
    slopes: dict[tuple[str, tuple[int, ...]], list[float]] = defaultdict(
        lambda: [0.0] * len(distribution.names)
    )
    named = {}
    for one in numbers:
        key = (one.field, one.place)
        slopes[key][distribution.names.index(one.parameter)] += one.slope
        named[key] = one
    text = ""
    for field in dict.fromkeys(field for field, _ in slopes):
        text += f"    {field!r}: [\n"
        for key in [key for key in slopes if key[0] == field]:
            one = named[key]
            kind, name = one.owner or (None, None)
            entry = (kind, name, one.row, one.mean, slopes[key])
            text += f"        {entry!r},\n"
        text += "    ],\n"
    return text
