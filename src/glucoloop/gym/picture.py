"""Picture of an episode so far: glucose and readings above, insulin and meals below.

Matplotlib is imported when a picture is first drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.refusal import Refusal

_SIZE_INCHES: Final = (8.0, 5.0)
_DOTS_PER_INCH: Final = 80
_WITHOUT_WINDOW: Final = ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template")
"""Backends of matplotlib that write files only."""


class EpisodePicture:
    """Picture of one person's episode, from the `info` of its steps."""

    def __init__(self, mode: str) -> None:
        self._in_window = mode == "human"
        self._window: Any = None

    def draw(self, infos: Sequence[dict[str, Any]]) -> npt.NDArray[np.uint8] | None:
        """Array ``(height, width, 3)`` of the picture, or None for one that stands in a window."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        if self._in_window:
            self._show(infos)
            return None
        figure = Figure(figsize=_SIZE_INCHES, dpi=_DOTS_PER_INCH)
        canvas: Any = FigureCanvasAgg(figure)
        _draw(figure, infos)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            import matplotlib.pyplot as plt

            plt.close(self._window)
            self._window = None

    def _show(self, infos: Sequence[dict[str, Any]]) -> None:
        import matplotlib
        import matplotlib.pyplot as plt

        backend = matplotlib.get_backend()
        refusal = Refusal(
            f"render_mode 'human' needs a window, which matplotlib's backend {backend} cannot open; use "
            "render_mode 'rgb_array'"
        )
        if backend.lower() in _WITHOUT_WINDOW:
            raise refusal
        if self._window is None:
            try:
                self._window = plt.figure(figsize=_SIZE_INCHES)
            except (ImportError, RuntimeError):  # a backend whose library or display is not there
                raise refusal from None
        _draw(self._window, infos)
        plt.pause(0.001)


def _draw(figure: Any, infos: Sequence[dict[str, Any]]) -> None:
    figure.clear()
    hours, glucose, reading, insulin, carbs = (
        np.array([info[name] for info in infos], float)
        for name in ("t_min", "glucose_mg_dl", "reading_mg_dl", "insulin_U", "carbohydrate_g")
    )
    hours /= 60.0
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    above.axhspan(70.0, 180.0, color="tab:green", alpha=0.15)
    above.plot(hours, glucose, color="black", label="glucose")
    above.plot(hours, reading, ".", markersize=3, color="tab:red", label="reading")
    above.set_ylabel("glucose [mg/dl]")
    above.set_title(f"person {int(infos[-1]['person'])}", loc="left")
    above.legend(loc="upper right")
    # what was given in the step that ended there
    below.step(hours[1:], insulin[1:], where="pre", color="tab:blue")
    below.set_ylabel("insulin [U per step]")
    below.set_xlabel("time [h]")
    meals = np.flatnonzero(carbs > 0.0)
    for at in meals.tolist():
        below.annotate(f"{carbs[at]:.0f} g", (hours[at], 0.0), rotation=90, va="bottom", ha="right")
