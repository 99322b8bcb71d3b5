"""The baseline of the benchmark: the log posterior that a user would write alone.

In NumPy and `scipy.integrate.solve_ivp`. J and K are sampled. Each slew starts from the first
readings: nothing is integrated out, which spares this baseline 48 dimensions. The rate bias is
taken as zero, wheels follow the commands, J and K have the campaign's Gaussian prior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from bayes_inertia.campaign.campaign import Campaign
from bayes_inertia.campaign.slew import Slew


@dataclass(frozen=True)
class ByHand:
    """Log posterior densities of theta = (Jxx, Jyy, Jzz, Jxy, Jxz, Jyz, K1, K2, K3) for a campaign
    with three or more wheels' commands.
    """

    campaign: Campaign  # the telemetry
    method: str = "DOP853"  # of `solve_ivp`
    rtol: float = 1e-8
    atol: float = 1e-10
    rest: float = 15.0  # seconds at the beginning of each slew in which the spacecraft rests

    def __call__(self, theta: np.ndarray) -> float:
        """The density at one theta (9,): slew after slew."""
        J, K = _tensor(theta), theta[6:9]
        if np.linalg.eigvalsh(0.5 * np.trace(J) * np.eye(3) - J)[0] <= 0.0:
            return -np.inf
        chi2 = 0.0
        for slew in self.campaign.slews:
            start, wheel = self.start(slew, K[None])
            path = self.fly(slew.time, slew.wheel_torque[None], start, wheel, J[None])[0]
            chi2 += self._chi2(slew, path, wheel[0], K)
        return -0.5 * chi2 + self._log_prior(theta)

    def batch(self, thetas: np.ndarray) -> np.ndarray:
        """The densities at many thetas (n, 9), all walkers and slews integrated as one system of
        equations.
        """
        n, slews = len(thetas), self.campaign.slews
        longest = max(slews, key=lambda slew: len(slew.time))
        J, K = np.array([_tensor(theta) for theta in thetas]), thetas[:, 6:9]
        starts, wheels, torques = [], [], []
        for slew in slews:
            start, wheel = self.start(slew, K)
            starts.append(start)
            wheels.append(wheel)
            torque = np.zeros_like(longest.wheel_torque)
            torque[: len(slew.time)] = slew.wheel_torque
            torques.append(np.broadcast_to(torque, (n, *torque.shape)))
        paths = self.fly(
            longest.time,
            np.concatenate(torques),
            np.concatenate(starts),
            np.concatenate(wheels),
            np.tile(J, (len(slews), 1, 1)),
        )
        densities = np.array([self._log_prior(theta) for theta in thetas])
        for s, slew in enumerate(slews):
            for i in range(n):
                densities[i] -= 0.5 * self._chi2(
                    slew, paths[s * n + i, : len(slew.time)], wheels[s][i], K[i]
                )
        physical = (
            np.linalg.eigvalsh(0.5 * np.trace(J, axis1=1, axis2=2)[:, None, None] * np.eye(3) - J)[
                :, 0
            ]
            > 0.0
        )
        return np.where(physical, densities, -np.inf)

    def start(self, slew: Slew, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Start states (n, 7), attitude and rate, and wheel momenta (n, wheels), from the first
        readings; K (n, 3).
        """
        resting = slew.time - slew.time[0] < self.rest
        fixes = slew.attitude[resting & np.isfinite(slew.attitude).all(1)]
        attitude = Rotation.from_quat(fixes).mean().as_quat()
        rate = K * slew.rate[resting].mean(0)
        return np.concatenate([np.broadcast_to(attitude, (len(K), 4)), rate], 1), np.broadcast_to(
            slew.wheel_momentum[0], (len(K), len(self.campaign.wheels))
        )

    def fly(
        self,
        time: np.ndarray,
        torque: np.ndarray,
        start: np.ndarray,
        wheel: np.ndarray,
        J: np.ndarray,
    ) -> np.ndarray:
        """Attitude, rate and wheel momentum relative to the body (n, rows, 7 + wheels): commands
        (n, rows, wheels) are held until the next row.
        """
        axes, spin = self.campaign.wheel_axes_B, self.campaign.spin_inertias
        time = time - time[0]
        n = len(start)
        absolute = wheel + spin * (start[:, 4:] @ axes)
        gained = np.cumsum(torque[:, :-1] * np.diff(time)[:, None], axis=1)
        momentum = absolute[:, None] + np.concatenate([np.zeros((n, 1, len(spin))), gained], 1)
        solution = solve_ivp(
            _slope(time, torque, momentum, axes, J),
            (0.0, time[-1]),
            start.ravel(),
            method=self.method,
            t_eval=time,
            rtol=self.rtol,
            atol=self.atol,
        )
        path = solution.y.T.reshape(len(time), n, 7).transpose(1, 0, 2)
        return np.concatenate([path, momentum - spin * (path[..., 4:] @ axes)], -1)

    def _chi2(self, slew: Slew, path: np.ndarray, wheel: np.ndarray, K: np.ndarray) -> float:
        sensor, tracker = self.campaign.rate_sensor, self.campaign.star_tracker
        rate = (slew.rate - path[:, 4:7] @ sensor.axes.T / K) / np.array(sensor.sigma)
        fixed = np.isfinite(slew.attitude).all(1)
        turn = (
            Rotation.from_quat(path[fixed, :4]).inv() * Rotation.from_quat(slew.attitude[fixed])
        ).as_rotvec()
        along = turn @ np.array(tracker.boresight_B)
        across = (turn**2).sum(1) - along**2
        momentum = (slew.wheel_momentum - path[:, 7:]) / np.array(
            [w.momentum_sigma for w in self.campaign.wheels]
        )
        return float(
            np.sum(rate**2)
            + np.sum(across) / tracker.sigma_cross**2
            + np.sum(along**2) / tracker.sigma_roll**2
            + np.sum(momentum**2)
        )

    def _log_prior(self, theta: np.ndarray) -> float:
        prior, sensor = self.campaign.inertia, self.campaign.rate_sensor
        z = np.concatenate(
            [
                (theta[:6] - prior.elements) / prior.sd,
                (theta[6:9] - sensor.scale_factor) / sensor.scale_factor_sigma,
            ]
        )
        return -0.5 * float(z @ z)


def _slope(
    time: np.ndarray, torque: np.ndarray, momentum: np.ndarray, axes: np.ndarray, J: np.ndarray
) -> Callable[[float, np.ndarray], np.ndarray]:
    """Derivative of all states, flattened: attitude and rate of n flights as one system."""
    inverse, n = np.linalg.inv(J), len(J)

    def slope(t: float, flat: np.ndarray) -> np.ndarray:
        state = flat.reshape(n, 7)
        k = min(int(np.searchsorted(time, t, side="right")) - 1, len(time) - 1)
        H = momentum[:, k] + torque[:, k] * (t - time[k])
        e, eta, w = state[:, :3], state[:, 3:4], state[:, 4:]
        total = np.einsum("nij,nj->ni", J, w) + H @ axes.T
        acceleration = np.einsum("nij,nj->ni", inverse, -torque[:, k] @ axes.T - _cross(w, total))
        return np.concatenate(
            [
                0.5 * (_cross(e, w) + eta * w),
                -0.5 * (e * w).sum(1, keepdims=True),
                acceleration,
            ],
            1,
        ).ravel()

    return slope


def _tensor(theta: np.ndarray) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = theta[:6]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    # numpy.cross takes three times as long on arrays this small.
    return np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        1,
    )
