"""Environments of Gymnasium: an agent doses one person, or many side by side."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop._lazy_jax import jnp
from glucoloop.component.effects import (
    AHEAD,
    ANNOUNCEMENTS,
    BOLUSES,
    OF_CONTROLLERS,
    READINGS,
    TIME_OF_DAY,
    warn_without_effect,
)
from glucoloop.control.guard_settings import guard_of
from glucoloop.gym.people import DosedPeople
from glucoloop.gym.picture import EpisodePicture
from glucoloop.gym.rewards import RewardFunction, kovatchev_risk, reward_of
from glucoloop.refusal import Refusal, needed_for
from glucoloop.situations.unused import without_effect
from glucoloop.units import (
    LARGEST_COUNTER,
    LONGEST_AHEAD_MIN,
    MIN_PER_DAY,
    MIN_PER_H,
    MU_PER_U,
    mu_min_from_u_h,
    u_h_from_mu_min,
)

with needed_for("an environment"):
    import gymnasium
    from gymnasium.spaces import Box
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space

Floats = npt.NDArray[np.float32]
Observed = dict[str, npt.NDArray[Any]]

_MAX_GLUCOSE_MG_DL: Final = 1000.0
"""Largest reading or glucose in an observation; one beyond is shown as this."""
_MAX_CARBS_G: Final = 1000.0


class _Situation:
    """People, their spaces and their rewards, which both environments have."""

    def __init__(
        self,
        number: int,
        *,
        reward: str | RewardFunction = "bounded-risk",
        truth: bool = False,
        guard: bool | str | None = None,
        lowest_mg_dl: float | None = None,
        highest_mg_dl: float | None = None,
        threads: int | None = None,
        **settings: Any,
    ) -> None:
        if guard:
            settings["guard"] = "usual" if guard is True else guard
        self._reward, self._truth = reward_of(reward), truth
        own = zip((lowest_mg_dl, highest_mg_dl), self._reward.bounds_mg_dl, strict=True)
        self._bounds = least, most = tuple(default if bound is None else bound for bound, default in own)
        if not least < most or (lowest_mg_dl is not None and lowest_mg_dl <= 0.0):
            raise Refusal(
                f"glucose from {least:g} to {most:g} mg/dl is no range; give a lowest_mg_dl above 0 "
                "and a highest_mg_dl above it"
            )
        self.people = DosedPeople(settings, number, threads)
        self._is_seeded = "seed" in settings
        trial = self.people.trial
        agent = {ANNOUNCEMENTS, AHEAD, TIME_OF_DAY, *([] if truth else [READINGS])}
        agent |= {BOLUSES} if self.people.gives_bolus else set()
        agent |= guard_of(trial.patient, trial.guard).uses() if trial.guard is not None else set()
        warn_without_effect(without_effect(trial, uses=trial.uses() - OF_CONTROLLERS | agent), stacklevel=3)
        low, high = ([u_h_from_mu_min(float(rate))] for rate in (trial.limits.min_mU_min, trial.limits.max_mU_min))
        most_U = high[0] * trial.sample_time_min / MIN_PER_H
        self.action_names: tuple[str, ...] = ("basal_U_h",)
        if self.people.gives_bolus:
            self.action_names += ("bolus_U",)
            bolus_U = float(trial.bolus.max_mU) / MU_PER_U
            low, high, most_U = [*low, 0.0], [*high, bolus_U], most_U + bolus_U
        self._pump = trial.glucagon_limits
        if self._pump is not None:
            self.action_names += ("glucagon_ug",)
            low, high = [*low, 0.0], [*high, float(self._pump.max_ug)]
        self.action_box = Box(np.array(low, np.float32), np.array(high, np.float32))
        seen = {"glucose_mg_dl": ("mg/dl", _MAX_GLUCOSE_MG_DL)}
        if not truth:
            seen = {
                "reading_mg_dl": ("mg/dl", _MAX_GLUCOSE_MG_DL),
                "reading_age_min": ("min", trial.horizon_min),
            }
        seen |= {
            "insulin_U": ("U", most_U),
            "announced_g": ("g", _MAX_CARBS_G),
            "time_of_day_min": ("min", MIN_PER_DAY),
        }
        self._ahead = bool(trial.announce_before_min)
        if self._ahead:
            seen["announced_in_min"] = ("min", LONGEST_AHEAD_MIN)
        if self._pump is not None:
            seen["glucagon_ug"] = ("ug", float(self._pump.max_ug))
        self.observation_names = tuple(seen)
        self.observation_units = tuple(unit for unit, _ in seen.values())
        highest = np.array([most for _, most in seen.values()], np.float32)
        self.observation_box = Box(np.zeros_like(highest), highest)
        self._latest = np.full(number, np.nan)
        self._read_at, self._requested_U, self._glucagon_ug = np.zeros(number), np.zeros(number), np.zeros(number)

    def reset(self, seed: int | None, random: np.random.Generator) -> None:
        """Let the next people begin; two environments that nobody gave a seed are different people."""
        if seed is None and not self._is_seeded:
            seed = int(random.integers(LARGEST_COUNTER + 1))
        self._is_seeded = True
        self.people.reset(seed)

    def observation(self) -> Floats:
        """(people, entries) observation at the coming sample, with the latest reading that was valid."""
        people, every = self.people, self.people.trial.sample_time_min
        begins, valid = people.sample == 0, np.isfinite(people.reading_mg_dl)
        # before the first reading of a sensor that warms up, the person is taken to be where the controller aims
        self._latest[begins], self._read_at[begins], self._glucagon_ug[begins] = people.trial.target_mg_dl, 0.0, 0.0
        self._latest[valid] = people.reading_mg_dl[valid]
        self._read_at[valid] = people.sample[valid]
        # a pump that says nothing is taken to have done as it was asked
        reported = np.where(np.isfinite(people.reported_U), people.reported_U, self._requested_U)
        age_min = (people.sample - self._read_at) * every
        seen = [people.glucose_mg_dl] if self._truth else [self._latest, age_min]
        announced = people.announced_g
        ahead = [np.where(announced > 0.0, people.trial.announce_before_min, 0.0)] if self._ahead else []
        dual = [] if self._pump is None else [self._glucagon_ug]
        rows = np.stack([*seen, reported, announced, people.time_of_day_min, *ahead, *dual], axis=-1)
        box = self.observation_box
        return np.asarray(np.clip(np.nan_to_num(rows), box.low, box.high), np.float32)

    def info(self) -> Observed:
        """Glucose, reading, insulin, carbohydrate, risk, time and number of each person, unknown to an agent."""
        people = self.people
        return {
            "glucose_mg_dl": people.glucose_mg_dl.copy(),
            "reading_mg_dl": people.reading_mg_dl.copy(),
            "insulin_U": people.insulin_U,
            "carbohydrate_g": people.eaten_g,
            "risk": kovatchev_risk(people.glucose_mg_dl),
            "t_min": people.sample * people.trial.sample_time_min,
            "person": people.person.copy(),
        }

    def step(self, action: npt.ArrayLike) -> tuple[Any, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Dose everybody; reward, and who has come to bounds of glucose, and to the end."""
        people = self.people
        requested = np.asarray(action, np.float64)
        wanted = people.number, len(self.action_names)
        if requested.shape != wanted:
            raise Refusal(f"an action of the shape {requested.shape} is not possible; give {wanted}")
        before = people.glucose_mg_dl.copy()
        bolus_U = requested[:, 1] if people.gives_bolus else np.zeros(people.number)
        self._requested_U = requested[:, 0] * people.trial.sample_time_min / MIN_PER_H + bolus_U
        glucagon_ug = None
        if self._pump is not None:
            glucagon_ug = requested[:, -1]
            self._glucagon_ug = np.array(self._pump.allowed(jnp.asarray(glucagon_ug)), np.float64)
        people.step(mu_min_from_u_h(requested[:, 0]), bolus_U * MU_PER_U if people.gives_bolus else None, glucagon_ug)
        after, (lowest, highest) = people.glucose_mg_dl, self._bounds
        terminated = ~((after >= lowest) & (after <= highest) & np.isfinite(after))
        reward = np.asarray(self._reward.of_step(before, after), np.float64)
        left = people.samples - people.sample
        reward = reward - np.where(terminated, self._reward.termination + self._reward.each_step_left * left, 0.0)
        return reward, terminated, (people.sample >= people.samples) & ~terminated


class _MadeAgain:
    """A copy, by `copy` or `pickle`, is made from the same arguments, and is before its first episode.

    Compiled loops cannot be copied. Gymnasium's own `EzPickle` means the same by a copy.
    """

    spec: Any
    _arguments: dict[str, Any]

    def __getstate__(self) -> dict[str, Any]:
        return {"arguments": self._arguments, "spec": self.spec}

    def __setstate__(self, state: dict[str, Any]) -> None:
        type(self).__init__(self, **state["arguments"])
        self.spec = state["spec"]


class GlucoseVectorEnv(_MadeAgain, VectorEnv[Floats, npt.NDArray[Any], npt.NDArray[Any]]):
    """Many people side by side, in native code where the patient allows it.

    Arguments are those of `GlucoseEnv`, the number of people, and when a place whose episode has ended gets the next
    person: at the next step, whose action is not used there (Gymnasium's ``AutoresetMode.NEXT_STEP``, the default), or
    in the same one (``SAME_STEP``), which then returns the first observation of the next person, and the last one of
    the former in ``info["final_obs"]``. Each place is at a sample of its own, so that this costs nothing for the
    others.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 # as Gymnasium declares it

    def __init__(
        self,
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **settings: Any,
    ) -> None:
        modes = {mode.value: mode for mode in (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)}
        name = getattr(autoreset_mode, "value", autoreset_mode)
        if name not in modes:
            raise Refusal(f"the autoreset_mode {name!r} is not possible; give one of {', '.join(modes)}")
        self.metadata = {**self.metadata, "autoreset_mode": modes[name]}
        if render_mode is not None:
            raise Refusal("a picture is of one person; leave render_mode out, or make one environment for it")
        self.render_mode = render_mode
        given = {"num_envs": num_envs, "render_mode": render_mode, "autoreset_mode": autoreset_mode}
        self._arguments = {**given, **settings}
        self._of = _Situation(num_envs, **settings)
        self.num_envs = num_envs
        self.single_action_space, self.single_observation_space = self._of.action_box, self._of.observation_box
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_names, self.observation_names = self._of.action_names, self._of.observation_names
        self.observation_units = self._of.observation_units
        self._ended: npt.NDArray[np.bool_] | None = None

    @property
    def people(self) -> DosedPeople:
        """The people, with their trial."""
        return self._of.people

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, Observed]:
        """Let the next person begin in every place; with a seed the first ones of that seed.

        Without any seed, here or in the situation, the first reset draws one.
        """
        if seed is not None and not isinstance(seed, int | np.integer):
            raise Refusal(f"seeds {seed!r} are not possible; give one whole number, of which all people are drawn")
        super().reset(seed=None if seed is None else int(seed), options=options)
        self._of.reset(seed, self.np_random)
        self._ended = np.zeros(self.num_envs, bool)
        return self._of.observation(), self._of.info()

    def step(self, actions: npt.ArrayLike) -> tuple[Floats, Any, Any, Any, Observed]:
        """Dose everybody, ``(people, 1 to 3)``, until the next sample."""
        if self._ended is None:
            raise Refusal("nobody is there yet; call reset first")
        reward, terminated, truncated = self._of.step(actions)
        begins = np.flatnonzero(self._ended)
        if begins.size:
            self._of.people.begin(begins)
            reward[begins], terminated[begins], truncated[begins] = 0.0, False, False
        self._ended = terminated | truncated
        observation, info = self._of.observation(), self._of.info()
        if self.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP and self._ended.any():
            observation, info = self._with_next_people(observation, info, self._ended)
            self._ended = np.zeros(self.num_envs, bool)
        return observation, reward, terminated, truncated, info

    def _with_next_people(
        self, observation: Floats, info: Observed, ended: npt.NDArray[np.bool_]
    ) -> tuple[Floats, Observed]:
        """Let the next people begin where episodes have ended; what was last there is told beside."""
        last = np.full(self.num_envs, None, dtype=object)
        for place in np.flatnonzero(ended):
            last[place] = observation[place]
        self._of.people.begin(np.flatnonzero(ended))
        of_last: dict[str, Any] = {"final_obs": last, "_final_obs": ended, "final_info": info, "_final_info": ended}
        return self._of.observation(), {**self._of.info(), **of_last}


class GlucoseEnv(_MadeAgain, gymnasium.Env[Floats, npt.NDArray[Any]]):
    """One person whose insulin an agent doses, in the situation of a trial.

    Actions are the basal rate [U/h], where insulin is given subcutaneously a bolus [U] that is given at the beginning
    of the step, and with ``glucagon=True`` glucagon [ug] that enters evenly, within the limits of the pump.
    Observations are named in ``observation_names``, with units in ``observation_units``: the latest valid reading (the
    target before the first) and its age, the insulin of the last step as the pump reports it, the announced
    carbohydrate of the coming step, and the time of day; with ``announce_before_min`` also the time until the announced
    meal is eaten, and with glucagon the amount that was asked of the pump in the last step, within its limits. The
    episode is terminated where glucose leaves its bounds, if it has some, and truncated at the end of the run.

    Parameters
    ----------
    reward : str or callable
        A name of `rewards.REWARDS`, or a function of glucose before and after the step, ``(people,)`` each [mg/dl].
    truth : bool
        Whether glucose itself is observed in place of reading and age.
    guard : bool or str
        Put a guard between agent and pump, like ``True`` or ``"usual, max_hour=2"``; see `control.guarded`.
    lowest_mg_dl, highest_mg_dl : float, optional
        Bounds of glucose beyond which an episode is terminated; by default those of the reward, of which
        ``bounded-risk`` has none and all others 10 and 600.
    threads : int, optional
        Number of threads; by default one, or one for each core for many people. It changes no result.
    **settings
        Keys of a trial's file, like ``patient="hovorka-2004"``, ``sensor=["dexcom-g6"]``, ``meals=["45g@7h"]`` or
        ``days=2``. With ``people`` the persons of that many numbers come again and again, from ``first_person`` on; by
        default every episode has another.

    Warns
    -----
    NoEffectWarning
        For a setting that was given and changes nothing, like ``profile_by`` without a guard.

    Raises
    ------
    Refusal
        For settings that are not possible, or that concern controllers.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 4}  # noqa: RUF012 # as Gymnasium declares it

    def __init__(self, *, render_mode: str | None = None, **settings: Any) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise Refusal(f"unknown render_mode {render_mode!r}; the known ones are: human, rgb_array")
        self.render_mode = render_mode
        self._picture = None if render_mode is None else EpisodePicture(render_mode)
        self._episode: list[dict[str, Any]] = []
        self._arguments = {"render_mode": render_mode, **settings}
        self._of = _Situation(1, **settings)
        self.action_space, self.observation_space = self._of.action_box, self._of.observation_box
        self.action_names, self.observation_names = self._of.action_names, self._of.observation_names
        self.observation_units = self._of.observation_units
        self._goes_on = False

    @property
    def people(self) -> DosedPeople:
        """The person, with the trial."""
        return self._of.people

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Let the next person begin; with a seed the first one of that seed.

        Without any seed, here or in the situation, the first reset draws one.
        """
        super().reset(seed=seed, options=options)
        self._of.reset(seed, self.np_random)
        self._goes_on = True
        self._episode = []
        return self._of.observation()[0], self._happened()

    def step(self, action: npt.ArrayLike) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Dose the person until the next sample."""
        if not self._goes_on:
            raise Refusal("the episode has not begun or has ended; call reset first")
        reward, terminated, truncated = (values[0] for values in self._of.step(np.asarray(action)[None]))
        self._goes_on = not (terminated or truncated)
        return self._of.observation()[0], float(reward), bool(terminated), bool(truncated), self._happened()

    def render(self) -> Any:
        """Picture of the episode so far ``(height, width, 3)``, or None where it stands in a window or is not wanted.

        With the ``render_mode`` "human" the window follows each step by itself.
        """
        if self._picture is None:
            gymnasium.logger.warn("render() draws nothing without a render_mode; give 'rgb_array' or 'human'")
            return None
        if not self._episode:
            raise Refusal("nobody is there yet; call reset first")
        return self._picture.draw(self._episode)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._picture is not None:
            self._picture.close()

    def _happened(self) -> dict[str, Any]:
        info = self._info()
        if self._picture is not None:
            self._episode.append(info)
            if self.render_mode == "human":
                self._picture.draw(self._episode)
        return info

    def _info(self) -> dict[str, Any]:
        return {name: values[0].item() for name, values in self._of.info().items()}
