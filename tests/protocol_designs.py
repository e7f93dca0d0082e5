"""Sums of a protocol made again and again: its design columns once, then another force in milliseconds.

Made from the contact model's own branch states, not by the kernels that sum a log in the product.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from tissueid.fit.candidates import SpecimenSums
from tissueid.likelihood.basis import kernel_basis
from tissueid.model.kernels import branch_state
from tissueid.synth import simulate


class Designs:
    """Columns 1, x, x^2, x^3 and node states by power of x for every log of a recipe, in contact at rest.

    Parameters
    ----------
    plan : Recipe
    degree : int
        Highest degree of K.
    phi : float
        Correlation of neighbouring samples that the sums are whitened for.
    """

    def __init__(self, plan, *, degree, phi=0.0):
        self.plan, self.degree, self.phi = plan, degree, phi
        logs = simulate(replace(plan, sigma_N=0.0), rng=np.random.default_rng(0))
        self.step = 1.0 / plan.rate_Hz
        self.duration = max(float(log.time_s[-1]) for log in logs)
        self.depth = max(float(log.displacement_mm.max()) for log in logs)
        self.basis = kernel_basis(step_s=self.step, length_s=self.duration)
        self.columns, made = [], {}
        for log in logs:
            name = log.name.rsplit("-", 1)[0]
            if name not in made:
                columns = self._whitened(self._design(log))
                made[name] = columns, columns.T @ columns
            self.columns.append(made[name])
        self.count = np.array([log.time_s.size for log in logs])

    def _design(self, log):
        x = log.displacement_mm
        states = [branch_state(log.time_s, x, float(tau), 0.0) for tau in self.basis.tau_s]
        powers = [np.column_stack(states) * x[:, None] ** k for k in range(self.degree + 1)]
        return np.concatenate([x[:, None] ** np.arange(4.0), *powers], axis=1)

    def _whitened(self, z):
        out = np.array(z)
        out[1:] = (z[1:] - self.phi * z[:-1]) / np.sqrt(1.0 - self.phi**2)
        return out

    def clean(self, branches, *, gains=None):
        """Force without noise, a log each."""
        logs = simulate(replace(self.plan, sigma_N=0.0, branches=branches), rng=np.random.default_rng(0))
        gains = np.ones(len(logs)) if gains is None else gains
        return [gain * log.force_N for gain, log in zip(gains, logs, strict=True)]

    def noise(self, rng, sigma):
        """Noise of the correlation the sums are whitened for, a log each."""
        out = []
        for n in self.count:
            draws = rng.standard_normal(n)
            draws[1:] *= np.sqrt(1.0 - self.phi**2)
            out.append(sigma * lfilter([1.0], [1.0, -self.phi], draws))
        return out

    def sums(self, forces, *, offset_sd_mm):
        """Sums of a specimen with these forces."""
        size = self.columns[0][1].shape[0]
        gram = np.empty((len(forces), size + 1, size + 1))
        for i, (force, (columns, own)) in enumerate(zip(forces, self.columns, strict=True)):
            y = self._whitened(force)
            gram[i, :size, :size] = own
            gram[i, :size, size] = gram[i, size, :size] = columns.T @ y
            gram[i, size, size] = y @ y
        return SpecimenSums(
            gram=gram,
            count=self.count.copy(),
            offset_sd_mm=np.full(len(forces), offset_sd_mm),
            basis=self.basis,
            columns_degree=self.degree,
            depth_mm=self.depth,
            step_s=self.step,
            duration_s=self.duration,
            single=False,
            logs=np.arange(len(forces)),
        )
