"""Style and script of a trial's page beyond those of all pages."""

from __future__ import annotations

from typing import Final

RANGE_COLOURS: Final = {
    "below 54": "#8C1D18",
    "54 to 70": "#DB5A4B",
    "70 to 180": "#7DBE93",
    "180 to 250": "#F0CE62",
    "above 250": "#D8923A",
}
"""Colours of the ranges of glucose."""

STYLE: Final = """
body { max-width: 84rem; padding: 1rem 1.25rem; --faint: color-mix(in srgb, var(--ink) 62%, var(--paper)); }
section { margin-top: 2.6rem; }
h2 { font-size: 1.15rem; font-weight: 600; margin: 0 0 0.3rem; }
h3 { font-size: 0.95rem; font-weight: 600; margin: 0 0 0.3rem; overflow-wrap: anywhere; }
p { margin: 0; }
.lead { max-width: 48rem; }
.caption { color: var(--faint); font-size: 0.9rem; max-width: 52rem; margin-bottom: 1rem; }
.facts { display: grid; grid-template-columns: repeat(auto-fill, minmax(10.5rem, 1fr)); gap: 0.7rem 1.5rem;
         margin: 1rem 0 0; padding: 0.8rem 0; border: 1px solid var(--rule); border-width: 1px 0; }
.facts dt { color: var(--faint); font-size: 0.8rem; }
.facts dd { margin: 0; font-size: 0.95rem; overflow-wrap: anywhere; }
.facts .long { grid-column: span 2; }
.chip { display: inline-block; width: 0.65rem; height: 0.65rem; border-radius: 0.15rem; margin-right: 0.45rem; }
.swatch { display: inline-block; width: 1.1rem; height: 0.65rem; margin: 0 0.3rem 0 0.15rem; background: var(--ink); }
.band { white-space: nowrap; }
.cards { display: grid; grid-template-columns: repeat(var(--columns), minmax(0, 1fr)); gap: 1.6rem 1.8rem; }
.card { min-width: 0; }
.grids .card { width: 100%; max-width: 27rem; }
.zones { display: grid; grid-template-columns: repeat(5, minmax(0, 1fr)); gap: 0.3rem; margin-top: 0.3rem;
         font-size: 0.8rem; text-align: center; white-space: nowrap; font-variant-numeric: tabular-nums; }
.zones .chip { margin-right: 0.3rem; }
.scroll { margin-top: 0.6rem; }
.headlines { font-size: 0.95rem; }
.headlines thead th { min-width: 5rem; max-width: 10rem; }
.headlines thead th:not(.long) { white-space: nowrap; }
.headlines thead .long { min-width: 10rem; }
.headlines th:first-child { position: sticky; left: 0; background: var(--paper); }
.headlines th, .headlines td { padding: 0.3rem 1.4rem 0.3rem 0; }
.headlines th[scope=row] { padding-left: 0; }
.headlines tbody tr + tr > * { border-top: 1px solid var(--rule); }
.headlines td:last-child { color: var(--faint); }
.worst table { width: 100%; font-size: 0.85rem; }
.worst td:last-child, .worst th:last-child { width: 100%; padding-right: 0; }
.worst td { vertical-align: top; }
.worst tbody tr { cursor: default; }
.worst tbody tr:is(:hover, :focus) { background: rgba(128, 128, 128, 0.15); outline: none; }
.ranges { display: grid; gap: 0.7rem; font-variant-numeric: tabular-nums; }
.range { display: grid; grid-template-columns: 14rem minmax(0, 1fr) repeat(5, 5.2rem); gap: 0.3rem 0.5rem;
         align-items: center; }
.who { font-size: 0.95rem; font-weight: 600; overflow-wrap: anywhere; }
.bar { display: flex; height: 1.5rem; border-radius: 0.25rem; overflow: hidden; gap: 1px; }
.bar > span { flex-basis: 0; min-width: 2px; }
.share { font-size: 0.9rem; text-align: right; white-space: nowrap; }
.heads .share { font-size: 0.8rem; color: var(--faint); }
@media (max-width: 68rem) {
  .cards { grid-template-columns: repeat(min(var(--columns), 2), minmax(0, 1fr)); }
  .range { grid-template-columns: repeat(5, minmax(0, 1fr)); gap: 0.2rem; }
  .who, .bar { grid-column: 1 / -1; }
  .bar.empty, .heads .who { display: none; }
  .share { text-align: left; }
}
@media (max-width: 44rem) {
  .cards { grid-template-columns: minmax(0, 1fr); }
  .headlines th[scope=row] { white-space: normal; min-width: 8rem; }
  .headlines th, .headlines td { padding-right: 0.9rem; }
  .share { font-size: 0.8rem; }
  .share .chip { margin-right: 0.25rem; }
}
@media print { .card, .range { break-inside: avoid; } }
"""

SCRIPT: Final = """
// Panels of a section zoom together.
for (const group of document.querySelectorAll(".linked")) {
  const plots = [...group.querySelectorAll(".js-plotly-plot")];
  let busy = false;
  for (const plot of plots) plot.on("plotly_relayout", async (change) => {
    const keys = Object.keys(change).filter((key) => /^[xy]axis2?\\.(range|autorange)/.test(key));
    if (busy || !keys.length) return;
    busy = true;
    const same = Object.fromEntries(keys.map((key) => [key, change[key]]));
    await Promise.all(plots.filter((other) => other !== plot).map((other) => Plotly.relayout(other, same)));
    busy = false;
  });
}
// A row of a table singles out its person: two curves each, in the same order.
for (const card of document.querySelectorAll(".worst .card")) {
  const plot = card.querySelector(".js-plotly-plot");
  const rows = [...card.querySelectorAll("tbody tr")];
  const all = rows.flatMap((_, place) => [2 * place, 2 * place + 1]);
  const single = (place) =>
    Plotly.restyle(plot, { opacity: all.map((curve) => place < 0 || curve >> 1 === place ? 1 : 0.12) }, all);
  rows.forEach((row, place) => {
    for (const name of ["mouseenter", "focus"]) row.addEventListener(name, () => single(place));
    for (const name of ["mouseleave", "blur"]) row.addEventListener(name, () => single(-1));
  });
}
// On a touch screen a finger scrolls the page.
if (window.matchMedia("(pointer: coarse)").matches)
  for (const plot of document.querySelectorAll(".js-plotly-plot")) Plotly.relayout(plot, { dragmode: false });
"""
