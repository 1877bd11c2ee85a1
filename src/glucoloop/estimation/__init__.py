"""State estimation: the Kalman filter in filter form, steady and time-varying."""

from glucoloop.estimation.kalman import (
    Innovation,
    KalmanState,
    SteadyStateFilter,
    filter_gain,
    kalman_step,
    predict,
    riccati_step,
    steady_state_gain,
    update,
)
from glucoloop.estimation.steady_state import steady_state_covariance, steady_state_seen

__all__ = [
    "Innovation",
    "KalmanState",
    "SteadyStateFilter",
    "filter_gain",
    "kalman_step",
    "predict",
    "riccati_step",
    "steady_state_covariance",
    "steady_state_gain",
    "steady_state_seen",
    "update",
]
