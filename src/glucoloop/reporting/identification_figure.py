"""Figures of an identified model: Figs. 2 and 3 of Parker, Doyle & Peppas (1999)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from glucoloop.identification import Identification, Validation
from glucoloop.refusal import Refusal
from glucoloop.reporting import _style
from glucoloop.reporting._style import FONT_PT, GREY, OKABE_ITO, Width

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEIGHTS: Final = [1.3, 1.0, 1.0]
"""Heights of the panels of a validation."""


def plot_identification(
    identification: Identification,
    *,
    truth: ArrayLike | None = None,
    validation: Validation | None = None,
    insulin_deviation_mU_min: ArrayLike | None = None,
    title: str | None = None,
    width: Width = "double",
) -> Figure:
    """Draw the estimated and the smoothed impulse response, and the validation of the model.

    Parameters
    ----------
    truth : array_like, shape (M,), optional
        Impulse response free of noise [mg/dl per mU/min].
    validation : Validation, optional
        Adds the panels of `plot_validation`.
    insulin_deviation_mU_min : array_like, shape (N,), optional
        Input of the validation.
    title : str, optional
    width : {"single", "double"}
        Width of a printed column: 88 or 180 mm.

    Raises
    ------
    ValueError
        If the truth or the input has another length than it should, or the width is unknown.
    """
    names = [] if validation is None else _panels(insulin_deviation_mU_min)
    side_by_side = bool(names) and width == "double"
    heights = [2.0, *_HEIGHTS[: len(names)]]
    figure = _style.new_figure(width, 90.0 if side_by_side or not names else 40.0 + 32.0 * len(heights), title)
    mosaic: Any = [["response", name] for name in names] if side_by_side else [[name] for name in ["response", *names]]
    panels = figure.subplot_mosaic(mosaic, height_ratios=heights[1:] if side_by_side else heights)
    entries = _draw_response(panels["response"], identification, truth)
    if validation is not None:
        sample_time_min = identification.model.sample_time_min
        entries |= _draw_validation(panels, validation, sample_time_min, insulin_deviation_mU_min)
    return _finished(figure, panels, entries, width)


def plot_validation(
    validation: Validation,
    *,
    sample_time_min: float,
    insulin_deviation_mU_min: ArrayLike | None = None,
    title: str | None = None,
    width: Width = "single",
) -> Figure:
    """Draw measured and predicted glucose, the residuals, and the input if given.

    Arguments and errors are those of `plot_identification`.
    """
    names = _panels(insulin_deviation_mU_min)
    figure = _style.new_figure(width, 25.0 + 30.0 * len(names), title)
    panels = figure.subplot_mosaic([[name] for name in names], height_ratios=_HEIGHTS[: len(names)])
    entries = _draw_validation(panels, validation, sample_time_min, insulin_deviation_mU_min)
    return _finished(figure, panels, entries, width)


def _panels(insulin: ArrayLike | None) -> list[str]:
    return ["fit", "residuals"] if insulin is None else ["fit", "residuals", "input"]


def _draw_response(axes: Axes, identification: Identification, truth: ArrayLike | None) -> dict[str, Artist]:
    """Curves of the impulse response, and their entries in the legend."""
    estimate = np.asarray(identification.impulse_response)
    lag_min = identification.model.sample_time_min * np.arange(1, estimate.size + 1)
    axes.axhline(0.0, color=GREY, linewidth=0.6, zorder=1)
    curves: dict[str, tuple[ArrayLike, dict[str, Any]]] = {}
    if truth is not None:
        if np.shape(truth) != estimate.shape:
            raise Refusal(
                f"a true impulse response of shape {np.shape(truth)} cannot stand beside {estimate.size} "
                "coefficients; give as many"
            )
        curves["free of noise"] = truth, {"color": "black", "linewidth": 0.9, "linestyle": (0, (4, 2))}
    rings = {"linestyle": "none", "marker": "o", "markersize": 3, "markerfacecolor": "none", "markeredgewidth": 0.7}
    curves["estimated coefficients"] = estimate, {**rings, "color": OKABE_ITO[1]}
    if identification.laguerre_coefficients.size:
        smoothed = np.asarray(identification.smoothed_impulse_response)
        curves["Laguerre projection"] = smoothed, {"color": OKABE_ITO[0], "linewidth": 1.2}
    divisor, unit, tick = _style.time_axis(lag_min[-1], "single")
    lag = lag_min / divisor
    axes.set(xlabel=f"Time since the dose ({unit})", ylabel="Impulse response (mg/dl per mU/min)")
    axes.set_xlim(0.0, lag[-1] + lag[0])  # room for the last marker
    axes.xaxis.set_major_locator(_style.every(tick))
    return {name: axes.plot(lag, np.asarray(values, float), **look)[0] for name, (values, look) in curves.items()}


def _draw_validation(
    panels: dict[str, Axes], validation: Validation, sample_time_min: float, insulin: ArrayLike | None
) -> dict[str, Artist]:
    """Curves of the validation, and their entries in the legend."""
    predicted, residuals = np.asarray(validation.predicted_mg_dl), np.asarray(validation.residuals_mg_dl)
    t_min = sample_time_min * np.arange(predicted.size)
    fit, below = panels["fit"], panels["residuals"]
    look: dict[str, Any] = {"color": OKABE_ITO[0], "linewidth": 1.0, "linestyle": (0, (4, 1.5))}
    entries: dict[str, Artist] = {
        "measured glucose": fit.plot(t_min, predicted + residuals, color=GREY, linewidth=1.8, alpha=0.7)[0],
        "predicted glucose": fit.plot(t_min, predicted, **look)[0],
    }
    fit.set_ylabel("Glucose\ndeviation\n(mg/dl)")
    below.axhline(0.0, color=GREY, linewidth=0.6, zorder=1)
    below.plot(t_min, residuals, color=OKABE_ITO[1], linewidth=0.9)
    below.set_ylabel("Residual\n(mg/dl)")
    last = below
    if insulin is not None:
        u = np.asarray(insulin, float)
        if u.shape != (predicted.size - 1,):
            raise Refusal(
                f"an input of shape {u.shape} cannot belong to {predicted.size} readings; give one value per sample, "
                f"{predicted.size - 1}"
            )
        last = panels["input"]
        last.step(t_min, np.append(u, u[-1]), where="post", color=OKABE_ITO[2], linewidth=0.9)
        last.set_ylabel("Insulin\ndeviation\n(mU/min)")
    for axes in (fit, below, last):
        axes.sharex(fit) if axes is not fit else axes.set_xlim(0.0, t_min[-1])
        axes.tick_params(labelbottom=axes is last)
    last.set_xlabel("Time (min)")
    return entries


def _finished(figure: Figure, panels: dict[str, Axes], entries: dict[str, Artist], width: Width) -> Figure:
    _style.dress(*panels.values())
    for axes in panels.values():
        for axis in (axes.xaxis, axes.yaxis):
            axis.get_offset_text().set_fontsize(FONT_PT)
    figure.align_ylabels([axes for name, axes in panels.items() if name != "response"])
    _style.add_legend(figure, entries, width)
    return figure
