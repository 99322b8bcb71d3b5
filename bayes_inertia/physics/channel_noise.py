"""What is assumed of the noise of each channel: its distribution, and whether its scale is known.

Gaussian noise of the stated sigma is the default. Asked for, a channel has Student-t noise
(outliers then cost the fit little), and the scale of its noise is a parameter that is sampled
beside J and K.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from numbers import Real
from typing import Any

from bayes_inertia.campaign.sensors import CHANNELS
from bayes_inertia.errors import SettingsError
from bayes_inertia.maths.values import require_flags
from bayes_inertia.physics.densities import FAMILIES, Density
from bayes_inertia.physics.parameters import LogNormal, Parameter, scalar

# Owner of the noise parameters in a parameter space: "noise.rate_scale".
NOISE_OWNER = "noise"
_SAMPLED = "sampled"


@dataclass(frozen=True)
class ChannelNoise:
    """The noise of one channel.

    Parameters
    ----------
    family : {"gaussian", "student_t"}
        Distribution of each number over its stated sigma, of `physics.densities`.
    degrees : float or None
        Degrees of freedom of Student-t noise, at least 1; None if they are sampled. The stated
        sigma is then the scale of the distribution, not its standard deviation.
    scale_sampled : bool
        Whether a factor on the stated sigma is sampled.
    scale_spread : float
        Prior sd of that factor's logarithm; its prior median is 1.

    Raises
    ------
    SettingsError
        If a value is none that it can have.

    Examples
    --------
    >>> ChannelNoise("student_t").degrees
    4.0
    >>> ChannelNoise("cauchy")
    Traceback (most recent call last):
    bayes_inertia.errors.SettingsError: noise: no distribution is called 'cauchy'; ...
    """

    family: str = "gaussian"
    degrees: float | None = 4.0  # Tails of a real sensor (Lange et al. 1989).
    scale_sampled: bool = False
    scale_spread: float = 0.5  # 95 % of the stated sigmas are right to a factor 2.7

    def __post_init__(self) -> None:
        what, advice = f"no distribution is called {self.family!r}", " or ".join(FAMILIES)
        _require(self.family in [*FAMILIES], what, f"choose {advice}")
        require_flags(scale_sampled=self.scale_sampled)
        shape, degrees = self.density.shape, self.degrees
        if shape is not None and degrees is not None:
            advice = f"give {shape.least:g} or more, or None where they are sampled"
            good = _is_at_least(degrees, shape.least)
            _require(good, f"{degrees} {shape.title}", advice)
        what = f"a prior sd of {self.scale_spread} of the scale's logarithm"
        good = _is_at_least(self.scale_spread, 0.0) and self.scale_spread > 0.0
        _require(good, what, "give a number above 0")

    @property
    def density(self) -> Density:
        """The family."""
        return FAMILIES[self.family]

    @property
    def is_stated(self) -> bool:
        """Whether the noise is Gaussian and of the stated sigma."""
        return self.family == "gaussian" and not self.scale_sampled

    @property
    def heavy(self) -> bool:
        """Whether the noise has heavier tails than a Gaussian."""
        return self.density.heavy


def _require(condition: bool, what: str, advice: str, where: str = "noise") -> None:
    if not condition:
        raise SettingsError(what, where=where, advice=advice)


def _is_at_least(value: Any, least: float) -> bool:
    """Whether this is a number, and large enough."""
    return isinstance(value, Real) and least <= float(value) < float("inf")


@dataclass(frozen=True, init=False)
class NoiseModel:
    """The noise of all channels.

    Parameters
    ----------
    **channels : ChannelNoise
        By the channel's name, as in `rate=`; Gaussian of the stated sigma unless given.

    Examples
    --------
    >>> NoiseModel(rate=ChannelNoise("student_t", scale_sampled=True)).names
    ('noise.rate_scale',)
    """

    channels: tuple[tuple[str, ChannelNoise], ...]

    def __init__(self, **channels: ChannelNoise) -> None:
        for name, noise in channels.items():
            what, advice = f"{noise!r} is no ChannelNoise", "give ChannelNoise('student_t')"
            _require(isinstance(noise, ChannelNoise), what, advice, f"noise of {name}")
        ordered = sorted(channels, key=lambda c: CHANNELS.index(c) if c in CHANNELS else 99)
        chosen = tuple((c, channels[c]) for c in ordered if channels[c] != ChannelNoise())
        object.__setattr__(self, "channels", chosen)

    def of(self, channel: str) -> ChannelNoise:
        """The noise of one channel.

        Parameters
        ----------
        channel : str
            Its name.

        Returns
        -------
        ChannelNoise
        """
        return dict(self.channels).get(channel, ChannelNoise())

    @property
    def is_stated(self) -> bool:
        """Whether all noise is Gaussian and of the stated sigma."""
        return all(noise.is_stated for _, noise in self.channels)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the noise parameters that are sampled."""
        return tuple(f"{NOISE_OWNER}.{p.name}" for p in self.parameters())

    def parameters(self) -> tuple[Parameter, ...]:
        """The noise parameters that are sampled.

        Returns
        -------
        tuple of Parameter
            "rate_scale" (a factor on the stated sigma), "rate_degrees", and so on; log-normal.
        """
        parameters = []
        for channel, noise in self.channels:
            if noise.scale_sampled:
                prior = LogNormal(1.0, noise.scale_spread)
                parameters.append(scalar(f"{channel}_scale", unit="", prior=prior, null=1.0))
            shape = noise.density.shape
            if shape is not None and noise.degrees is None:
                prior, name = LogNormal(shape.median, shape.spread), f"{channel}_{shape.name}"
                parameters.append(scalar(name, unit="", prior=prior, null=shape.median))
        return tuple(parameters)

    def json(self) -> dict[str, Any]:
        """The noise model as plain values.

        Returns
        -------
        dict
            That `noise_model_from_json` reads.
        """
        names = dict.fromkeys((*CHANNELS, *(name for name, _ in self.channels)))
        return {name: asdict(self.of(name)) for name in names}

    def in_words(self) -> str:
        """The channels whose noise is not as stated.

        Returns
        -------
        str
            A few words each; empty where all noise is as stated.

        Examples
        --------
        >>> NoiseModel(attitude=ChannelNoise(scale_sampled=True)).in_words()
        'attitude Gaussian of sampled scale'
        """
        parts = []
        for channel, noise in self.channels:
            if noise.is_stated:
                continue
            number = "sampled" if noise.degrees is None else f"{noise.degrees:g}"
            shape = noise.density.shape
            family = noise.density.title + (f", {number} {shape.title}" if shape else "")
            joint = "," if shape else ""
            scale = f"{joint} of sampled scale" if noise.scale_sampled else ""
            parts.append(f"{channel} {family}{scale}")
        return "; ".join(parts)


def noise_model_from_json(content: Mapping[str, Any]) -> NoiseModel:
    """The noise model that its JSON describes.

    Examples
    --------
    >>> noise_model_from_json(NoiseModel().json()) == NoiseModel()
    True
    """
    if not isinstance(content, Mapping):
        raise TypeError(f"noise {content!r}")
    return NoiseModel(**{channel: ChannelNoise(**noise) for channel, noise in content.items()})


def noise_model_from_text(families: Sequence[str] = (), sampled: Sequence[str] = ()) -> NoiseModel:
    """The noise model that options of the command line describe.

    `families`: "channel=family" or "channel=student_t:degrees", the degrees a number or "sampled".

    Examples
    --------
    >>> noise_model_from_text(["rate=student_t:6"], ["rate"]).in_words()
    'rate Student-t, 6 degrees of freedom, of sampled scale'
    """
    chosen: dict[str, dict[str, Any]] = {}
    for text in families:
        channel, _, family = text.partition("=")
        channel = channel.strip()
        _require(bool(family), f"{text!r} has no distribution", "write rate=student_t", "--noise")
        _require(channel not in chosen, f"{channel} is given twice", "choose one", "--noise")
        name, _, degrees = family.strip().partition(":")
        chosen[channel] = {"family": name, **_degrees(name, degrees)}
    for channel in sampled:
        chosen.setdefault(channel, {})["scale_sampled"] = True
    return NoiseModel(**{channel: ChannelNoise(**values) for channel, values in chosen.items()})


def _degrees(family: str, text: str) -> dict[str, float | None]:
    """Degrees of freedom as they stand behind a family's name."""
    if not text:
        return {}
    has = family in FAMILIES and FAMILIES[family].shape is not None
    what = f"{family} has no degrees of freedom"
    _require(has, what, f"leave out :{text}", "--noise")
    if text == _SAMPLED:
        return {"degrees": None}
    try:
        return {"degrees": float(text)}
    except ValueError as error:
        advice = f"write a number or {_SAMPLED}: rate=student_t:6"
        what = f"{text!r} degrees of freedom"
        raise SettingsError(what, where="--noise", advice=advice) from error
