"""The frame of a self-contained HTML page: style for light and dark, wide and narrow screens; no script, no links."""

from __future__ import annotations

from html import escape

STYLES = 8
"""Methods that can be told apart: each has a colour (after Okabe & Ito 2008) and a pattern of dashes of its own."""

_LIGHT = ("#8a929c", "#0067a5", "#c84c00", "#00805d", "#a33d86", "#8a6100", "#3f6ad8", "#5b6b00", "#444444")
_DARK = ("#8d97a5", "#5bb8f0", "#ff9450", "#2ecf9f", "#ec8fcb", "#e8c14f", "#a9b8ff", "#c3d34a", "#d8d8d8")
_DASHES = ("none", "none", "9 4", "3 3", "12 4 3 4", "5 3", "16 5", "2 3 8 3", "7 3 2 3 2 3")


def _colours(values: tuple[str, ...]) -> str:
    return " ".join(f"--c{i}: {value};" for i, value in enumerate(values))


_CURVES = "\n".join(
    f".c{i} {{ stroke: var(--c{i}); stroke-width: {2.2 if i else 4.5}; stroke-dasharray: {dash}; }}"
    for i, dash in enumerate(_DASHES)
)

_RULES = """
* { box-sizing: border-box; }
body { margin: 0; background: var(--bg); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 2.2rem 1.25rem 3rem; }
h1, h2, p, li, dd { overflow-wrap: anywhere; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2.6rem 0 .7rem; }
h3 { font-size: 1rem; margin: 0 0 .35rem; }
p { margin: .4rem 0; }
.lead, .small, figcaption, caption { color: var(--soft); }
.small, figcaption, caption { font-size: .875rem; }
.warn { color: var(--warn); }

.scroll { overflow-x: auto; background: var(--card); border: 1px solid var(--line); border-radius: 10px;
  margin: 1.2rem 0 .8rem; }
.scroll:focus-visible { outline: 2px solid var(--c1); outline-offset: 2px; }
table { border-collapse: collapse; width: 100%; font-size: .95rem; font-variant-numeric: tabular-nums; }
th, td { padding: .5rem .62rem; text-align: right; white-space: nowrap; border-top: 1px solid var(--line); }
thead th { border-top: 0; font-weight: 600; vertical-align: bottom; line-height: 1.25; white-space: normal; }
thead small { font-weight: 400; color: var(--soft); }
tbody th { font-weight: 500; }
th:first-child, td.name, th.name { text-align: left; }
td.best { background: var(--best); font-weight: 650; }
td.warn { color: var(--warn); }
tr.mean th, tr.mean td { font-weight: 600; }
tr.mean.first th, tr.mean.first td { border-top: 2px solid var(--soft); }

.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 440px), 1fr)); gap: 1rem;
  margin-bottom: 1rem; }
.stack { display: grid; gap: 1rem; }
.card { min-width: 0; background: var(--card); border: 1px solid var(--line); border-radius: 10px;
  padding: .9rem .9rem .5rem; }
.plot { display: block; width: 100%; height: auto; }
.plot path, .swatch path { fill: none; stroke-linejoin: round; }
.plot text { font-size: 13px; fill: var(--soft); }
.plot .axis { fill: var(--ink); }
.plot .note { fill: var(--warn); }
.plot .grid { stroke: var(--grid); }
.plot .frame { fill: none; stroke: var(--line); }
.plot .mark { fill: var(--card); stroke: var(--ink); stroke-width: 2; }
.legend { display: flex; flex-wrap: wrap; gap: .3rem 1.3rem; list-style: none; margin: .6rem 0 .8rem; padding: 0; }
.legend li { display: inline-flex; align-items: center; gap: .5rem; }
.swatch { width: 34px; height: 10px; flex: none; }

.frames { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 300px), 1fr)); gap: .8rem; }
figure { margin: 0; }
figure img { display: block; width: 100%; height: auto; border-radius: 8px; background: var(--grid); }
figcaption { padding-top: .25rem; font-variant-numeric: tabular-nums; }
code, pre { font: .9rem/1.5 ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; }
pre { background: var(--card); border: 1px solid var(--line); border-radius: 10px; padding: .8rem .9rem;
  margin: .4rem 0 1rem; white-space: pre-wrap; overflow-wrap: anywhere; }
dl { display: grid; grid-template-columns: minmax(9rem, max-content) 1fr; gap: .35rem 1.2rem; margin: .4rem 0; }
dt { font-weight: 600; }
dd { margin: 0; color: var(--soft); }

@media (max-width: 600px) {
  main { padding: 1.3rem .9rem 2rem; }
  dl { grid-template-columns: 1fr; gap: 0; }
  dd { margin-bottom: .6rem; }
  .plot text { font-size: 16px; }
  th, td { padding: .45rem .5rem; }
  tbody th { white-space: normal; overflow-wrap: anywhere; min-width: 5.2rem; }
  td.name { white-space: normal; min-width: 7.6rem; }
  .frames { grid-template-columns: 1fr 1fr; }
  figcaption small { display: block; }
  .card { padding: .7rem .5rem .3rem; }
}
@media print { .card, .scroll, figure { break-inside: avoid; } }
"""

STYLE = f"""
:root {{ color-scheme: light dark; {_colours(_LIGHT)}
  --bg: #fbfcfd; --card: #fff; --ink: #14202b; --soft: #52606d; --line: #d9dfe5; --grid: #e9edf1;
  --warn: #a33b00; --best: #e3f1e8; }}
@media (prefers-color-scheme: dark) {{ :root {{ {_colours(_DARK)}
  --bg: #0e151b; --card: #161f27; --ink: #e6edf3; --soft: #a3b1be; --line: #2f3b46; --grid: #243039;
  --warn: #ffab73; --best: #173527; }} }}
{_RULES}{_CURVES}
"""


def page(title: str, body: str) -> str:
    """A whole HTML document."""
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>{STYLE}</style>
</head>
<body>
<main>
{body}
</main>
</body>
</html>
"""
