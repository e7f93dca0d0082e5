"""Tissues of laws of every kind, and bundles of them, for the tests of what takes any law."""

import numpy as np

from tissueid.model.channels import ChannelModel
from tissueid.model.grammar import known_laws, parsed
from tissueid.model.law import Shape
from tissueid.result import Estimate, ModelChoice
from tissueid.store.bundle import Bundle

#: Parameters of a tissue of each law.
LAWS = {
    "power * stretched": [12.0, 1.4, 30.0, 0.08, 0.5],
    "exponential * linear * power-law": [12.0, 0.15, 30.0, 4.0, 0.05, 0.3],
    "polynomial * tangent * prony:2": [20.0, 0.6, 0.2, 1.2, 0.02, 0.6, 0.3],
    "hertz * fung": [12.0, 30.0, 0.05, 20.0],
}
SPECTRUM = ("hertz * spectrum:3", [12.0, 20.0, 10.0, 5.0])
DEPTH_MM, RANGE_S = 6.0, (0.005, 4.0)


#: Coefficients of polynomials by the beginning of their names, of other laws, and the first relaxation time.
SIZES = {
    "static_1": 20.0, "static_2": -1.2, "static_3": 0.35, "stiffness_0": 30.0, "stiffness_1": 4.0,
    "stiffness_2": -0.2,
}  # fmt: skip
SIZE, TIME_S, SLOWER = 12.0, 0.4, 4.0


def of_kind(kind: str, *without: str) -> list[str]:
    """Keys of the registered laws of a kind."""
    return [key for key, law in known_laws().items() if law.about.kind == kind and key not in without]


def typical(model: ChannelModel) -> np.ndarray:
    """Theta of a tissue of any law; shapes lie where it says, further branches are slower and less."""
    theta = []
    for one in model.layout:
        spec = one.spec if isinstance(one, Shape) else one
        branch = int(spec.name.rpartition("_b")[2]) if "_b" in spec.name else 1
        if not isinstance(one, Shape):
            value = next((v for start, v in SIZES.items() if spec.name.startswith(start)), SIZE) / branch
        elif one.spec.unit == "s":
            value = TIME_S * SLOWER ** (branch - 1)
        else:
            value = float(np.exp(np.median(np.log(one.starts)))) / branch
        theta.append(value)
    return np.array(theta)


def law_of(name: str) -> ChannelModel:
    return parsed(name).model(DEPTH_MM, *RANGE_S)


def law_bundle(name: str, theta: list[float]) -> Bundle:
    """A tissue of a law as fit would leave it, of ramps from 1 to 4 mm/s."""
    model, values = law_of(name), np.array(theta)
    return Bundle(
        specimen=name,
        model=ModelChoice(name, model.branches, 3, model.stiffness_degree, "shared", name, RANGE_S),
        theta_names=model.parameter_names,
        theta=values,
        covariance=np.diag((0.02 * values) ** 2),
        parameters=tuple(
            Estimate(one.name, one.symbol, one.unit, float(value), 0.02 * abs(float(value)), identified=True)
            for one, value in zip(model.parameters, values, strict=True)
        ),
        depth_mm=DEPTH_MM,
        speeds_mm_s=(1.0, 4.0),
        tip_radius_mm=None,
        sigma_N=0.1,
        flags=(),
        provenance={"tissueid": "0", "versions": {}, "options": {}, "inputs": []},
        draws=values * np.exp(0.02 * np.random.default_rng(44).standard_normal((64, values.size))),
    )
