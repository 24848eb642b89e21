"""Gains of SimpleFlight's controllers, as scripts give them. Defaults: AirSim v1.8.1, simple_flight/Params.hpp."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class PIDGains:
    kp: float
    ki: float
    kd: float

    def to_list(self) -> list[float]:
        return [self.kp, self.ki, self.kd]


class _Gains:
    """Gains of three axes, in the order of the fields."""

    def to_lists(self) -> tuple[list[float], list[float], list[float]]:
        """kp, ki and kd of the three axes."""
        kp, ki, kd = zip(*(gains.to_list() for gains in vars(self).values()), strict=True)
        return list(kp), list(ki), list(kd)


@dataclass
class AngleRateControllerGains(_Gains):
    roll_gains: PIDGains = field(default_factory=lambda: PIDGains(0.25, 0, 0))
    pitch_gains: PIDGains = field(default_factory=lambda: PIDGains(0.25, 0, 0))
    yaw_gains: PIDGains = field(default_factory=lambda: PIDGains(0.25, 0, 0))


@dataclass
class AngleLevelControllerGains(_Gains):
    roll_gains: PIDGains = field(default_factory=lambda: PIDGains(2.5, 0, 0))
    pitch_gains: PIDGains = field(default_factory=lambda: PIDGains(2.5, 0, 0))
    yaw_gains: PIDGains = field(default_factory=lambda: PIDGains(2.5, 0, 0))


@dataclass
class VelocityControllerGains(_Gains):
    x_gains: PIDGains = field(default_factory=lambda: PIDGains(0.2, 0, 0))
    y_gains: PIDGains = field(default_factory=lambda: PIDGains(0.2, 0, 0))
    z_gains: PIDGains = field(default_factory=lambda: PIDGains(2.0, 2.0, 0))


@dataclass
class PositionControllerGains(_Gains):
    x_gains: PIDGains = field(default_factory=lambda: PIDGains(0.25, 0, 0))
    y_gains: PIDGains = field(default_factory=lambda: PIDGains(0.25, 0, 0))
    z_gains: PIDGains = field(default_factory=lambda: PIDGains(0.25, 0, 0))
