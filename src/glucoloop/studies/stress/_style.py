"""Style of the page of a stress test beyond that of all pages."""

from __future__ import annotations

from typing import Final

STYLE: Final = """
.verdict p { max-width: 58rem; margin-top: 0.5rem; }
.heat { border-collapse: separate; border-spacing: 2px; table-layout: fixed; width: 100%;
        min-width: calc(15rem + var(--cells) * 4.9rem); }
.heat th, .heat td { padding: 0.14rem 0.4rem; }
.heat col.fault { width: 14rem; }
.heat col.gap { width: 1rem; }
.heat thead th { border: 0; text-align: center; vertical-align: bottom; overflow-wrap: anywhere; }
.heat thead .guard { border-bottom: 1px solid var(--rule); }
.heat tbody th { padding-left: 0; white-space: nowrap; }
.heat thead .fault { padding-left: 0; }
.heat .fault, .heat tbody th { text-align: left; position: sticky; left: 0; background: var(--paper); }
.heat td { border-radius: 0.15rem; text-align: center; white-space: nowrap; }
.heat td.gap { padding: 0; }
.heat .none { box-shadow: inset 0 0 0 1px var(--rule); }
.heat tbody + tbody::before { content: ""; display: block; height: 0.45rem; }
.heat small { font-size: 0.78em; margin-left: 0.35em; }
.scale { display: flex; flex-wrap: wrap; gap: 0.3rem 1.1rem; font-size: 0.85rem; margin-bottom: 0.7rem; }
.scale .key { display: inline-block; width: 1.5rem; height: 0.85rem; margin-right: 0.4rem; border-radius: 0.15rem;
              vertical-align: -0.08rem; }
.scale .none { box-shadow: inset 0 0 0 1px var(--rule); }
.why { display: grid; grid-template-columns: minmax(10rem, 17rem) minmax(0, 1fr); gap: 0 1.5rem; margin: 0;
       max-width: 72rem; }
.why dt, .why dd { padding: 0.6rem 0; border-top: 1px solid var(--rule); }
.why dt { font-weight: 600; overflow-wrap: anywhere; }
.why dt span { display: block; font-weight: normal; }
.why dd { margin: 0; }
.why dd p + p { margin-top: 0.25rem; color: var(--faint); font-size: 0.85rem; }
.all h3 { margin-top: 1.6rem; }
.all table { font-size: 0.8rem; line-height: 1.3; width: 100%; }
.all th, .all td { padding: 0.1rem 0 0.1rem 0.55rem; white-space: nowrap; }
.all thead th { white-space: normal; text-align: right; }
.all thead .group { text-align: left; border-bottom: 0; padding-bottom: 0; }
.all th[scope=row] { white-space: nowrap; vertical-align: top; }
.all th[scope=row], .all thead tr:first-child th:first-child { padding-left: 0; position: sticky; left: 0;
        background: var(--paper); text-align: left; }
.all tbody tr:first-child > * { border-top: 1px solid var(--rule); padding-top: 0.25rem; }
.all tbody tr:last-child > * { padding-bottom: 0.25rem; }
.all .part { padding-left: 1.1rem; }
.all .guard { color: var(--faint); text-align: left; }
.all .worse { font-weight: 600; }
.faults td { vertical-align: top; }
.faults th[scope=row] { padding-left: 0; white-space: nowrap; vertical-align: top; }
.faults code { overflow-wrap: anywhere; }
@media (max-width: 44rem) { .heat col.fault { width: 9rem; } .heat tbody th { white-space: normal; } }
@media (max-width: 44rem) { .why { grid-template-columns: minmax(0, 1fr); } .why dd { border-top: 0; padding-top: 0; } }
@media print { .heat td { print-color-adjust: exact; } tbody, .why dd { break-inside: avoid; } }
"""
