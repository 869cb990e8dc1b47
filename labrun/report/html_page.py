"""The page around a report: one file without scripts, in light and dark, on a phone and on paper."""

from collections.abc import Sequence

from labrun.report.html_elements import Html, element, joined

_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""The browser itself refuses anything that would come from elsewhere."""

_STYLE = """
:root { color-scheme: light dark; --ink: #1a1a1a; --soft: #5c6066; --line: #d8dade; --paper: #ffffff; --field: #f4f5f7;
  --mark: #e8f1f8; --good: #00694c; --warn: #a34700; --bar: #0072b2; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e7e9; --soft: #a2a7ae; --line: #3a3e44; --paper: #16181b;
  --field: #202328; --mark: #1c2f3d; --good: #4fc79f; --warn: #f09a5b; --bar: #56b4e9; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans",
  sans-serif; -webkit-text-size-adjust: 100%; }
main { max-width: 62rem; margin: 0 auto; padding: 1.5rem 1.25rem 4rem; }
h1 { font-size: 1.65rem; line-height: 1.2; margin: 0 0 .3rem; text-wrap: balance; }
h2 { font-size: 1.2rem; margin: 2.6rem 0 .6rem; padding-top: .7rem; border-top: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 1.6rem 0 .4rem; }
p { margin: .5rem 0; max-width: 46rem; }
a { color: inherit; text-decoration-color: var(--soft); text-underline-offset: .15em; }
.where, figcaption, caption, .note { color: var(--soft); font-size: .88rem; }
.where { overflow-wrap: anywhere; }
.lead { font-size: 1.06rem; }
.best { display: flex; flex-wrap: wrap; gap: .4rem 2.5rem; margin: 1.1rem 0; padding: .9rem 1.1rem;
  background: var(--mark); border-left: 4px solid var(--bar); border-radius: 4px; }
.best b { display: block; font-size: 1.5rem; line-height: 1.3; font-variant-numeric: tabular-nums; }
.best .lucky b { font-weight: 400; color: var(--soft); }
.best span { color: var(--soft); font-size: .88rem; display: block; }
.best .at { flex-basis: 100%; color: var(--ink); font-size: .95rem; }
.checks { list-style: none; margin: 1rem 0; padding: 0; }
.checks li { padding: .3rem 0 .3rem 6.2rem; border-bottom: 1px solid var(--line); position: relative; }
.checks b { position: absolute; left: 0; font-weight: 600; font-size: .88rem; line-height: 1.7; }
.good { color: var(--good); } .look { color: var(--warn); } .open { color: var(--soft); }
.stop { border-left: 4px solid var(--warn); padding: .5rem .9rem; background: var(--field); border-radius: 4px;
  overflow-wrap: anywhere; }
figure { margin: 1rem 0; }
figure img { display: block; max-width: 100%; height: auto; background: #fff; border-radius: 4px; }
@media (prefers-color-scheme: dark) { figure img { padding: 4px; filter: brightness(.93); } }
figcaption { margin-top: .35rem; max-width: 46rem; }
.scroll { overflow-x: auto; margin: .7rem 0; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; padding-bottom: .25rem; }
th, td { padding: .28rem .55rem; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
th { font-weight: 600; vertical-align: bottom; line-height: 1.25; hyphens: auto; }
th.n, td.n { text-align: right; }
td.n { white-space: nowrap; }
th:first-child, td:first-child { padding-left: .2rem; }
tr.marked td { background: var(--mark); }
.bar { display: inline-block; width: 9rem; height: .7rem; background: var(--field); }
.bar span { display: block; height: 100%; background: var(--bar); }
.bar, .bar span, tr.marked td, .best { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
details { margin: .7rem 0; }
summary { cursor: pointer; font-weight: 600; }
pre { font: .8rem/1.45 ui-monospace, "DejaVu Sans Mono", monospace; overflow-x: auto; border-radius: 4px;
  background: var(--field); padding: .8rem 1rem; }
code { font: .88em ui-monospace, "DejaVu Sans Mono", monospace; overflow-wrap: anywhere; }
nav { color: var(--soft); font-size: .88rem; margin: 1rem 0; }
nav a { margin-right: 1rem; white-space: nowrap; }
@media (max-width: 34rem) { main { padding: 1rem .8rem 3rem; } h1 { font-size: 1.35rem; }
  .checks li { padding-left: 0; } .checks b { position: static; display: block; line-height: 1.3; }
  .bar { width: 4rem; } }
@media print { :root { --ink: #000; --soft: #444; --line: #bbb; --paper: #fff; --field: #f2f2f2; --mark: #eaf2f8;
  --good: #00694c; --warn: #a34700; --bar: #0072b2; }
  body { font-size: 10pt; } main { max-width: none; padding: 0; } nav { display: none; }
  figure, tr, .best, .checks li { break-inside: avoid; } h2, h3 { break-after: avoid; } .scroll { overflow: visible; }
  figure img { padding: 0; filter: none; max-height: 22cm; } pre { white-space: pre-wrap; } }
"""


def page(title: str, head: Html, sections: Sequence[tuple[str, str, Html]]) -> str:
    """Return a whole page.

    Parameters
    ----------
    title
        Of the window.
    head
        What stands before the first section.
    sections
        Anchor, short name for the list of links, and content of each.
    """
    links = (element("a", name, href=f"#{anchor}") for anchor, name, _ in sections)
    body = element(
        "main",
        head,
        element("nav", joined(links, " "), aria_label="on this page"),
        *(content for _, _, content in sections),
    )
    top = joined(
        [
            element("meta", charset="utf-8"),
            element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
            element("meta", name="viewport", content="width=device-width, initial-scale=1"),
            element("title", title),
            element("style", Html(_STYLE)),
        ]
    )
    return f'<!doctype html>\n<html lang="en"><head>{top}</head>\n<body>{body}</body></html>\n'
