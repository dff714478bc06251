"""HTML page on a results file: its maps as vector graphics, its numbers and its config, in a single file.

The page runs no script and fetches nothing: the policy in its head forbids both, and texts of the results are escaped.
"""

import io
from collections.abc import Iterator
from html import escape

from matplotlib.figure import Figure

from clunk.analysis.marks import thresholds_of
from clunk.core.status import Status
from clunk.plot.maps import MOST_VALUES, default_quantities, draw
from clunk.plot.plane import drawn_axes, parted_axes
from clunk.plot.style import styled
from clunk.results.maps import AnyMap
from clunk.study.records import Rows, columns_of, html_table

_STYLE = """
body { color: #1c2126; font: 15px/1.45 system-ui, sans-serif; margin: 2em auto; max-width: 60em; padding: 0 1em }
h1 { font-size: 1.5em } h2 { border-bottom: 1px solid #ccc; font-size: 1.15em; margin-top: 2em } h3 { font-size: 1em }
svg { display: block; height: auto; margin: 1em 0; width: 100% }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: 1em 0 }
td, th { border-bottom: 1px solid #e4e4e4; padding: 0.2em 1.2em 0.2em 0; vertical-align: top }
td { overflow-wrap: break-word }
pre { background: #f6f6f4; font-size: 13px; overflow-x: auto; padding: 0.8em }
@media print { pre { white-space: pre-wrap } svg { break-inside: avoid } }
"""
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<h1>{title}</h1>
{parts}
<h2>Versions and digests</h2>
{provenance}
<h2>Config</h2>
<pre>{config}</pre>
</body>
</html>
"""


def page(results: AnyMap, digests: Rows) -> str:
    """HTML of the page on a map.

    digests : name and value of each digest that identifies the map

    Raises PlotError where more axes have several values than the two of a map and two facets.
    """
    provenance = [*((name.removesuffix("_version"), value) for name, value in results.attributes.items()), *digests]
    return _PAGE.format(
        title=escape(results.title.strip() or "Impact regimes"),
        style=_STYLE,
        parts="\n".join(part for name in results.lash_names for part in _part(results.at_lash(name), name)),
        provenance=html_table(provenance),
        config=escape(results.config),
    )


def _part(part: AnyMap, lash: str) -> Iterator[str]:
    """HTML of the pictures and numbers of one lash, part by part."""
    thresholds = thresholds_of(part)
    if part.lashes:
        yield f"<h2>{escape(lash)}</h2>"
    _, surplus = parted_axes(drawn_axes(part))
    facets = [axis.parameter for axis in surplus[: len(MOST_VALUES)]]
    for name in default_quantities(part, facets=facets):
        yield _svg(draw(part, name, thresholds, facets=facets), name)
    heads, *rows = columns_of(part.label_table())
    yield f"{html_table([*part.summary(), *part.facts])}<h3>Labels</h3>{html_table(rows, heads)}"
    counts = ((status, (part.status == status).sum()) for status in Status if status != Status.OK)
    failures = [(f"{count:,}", status.sentence) for status, count in counts if count]
    if failures:
        yield html_table(failures, ("failed cells", "why"))


def _svg(figure: Figure, name: str) -> str:
    """A figure as an SVG element for HTML, without metadata and without the XML declarations of a file."""
    stream = io.BytesIO()
    with styled():
        figure.savefig(stream, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    text = stream.getvalue().decode()
    return text[text.index("<svg") :].replace("<svg", f'<svg role="img" aria-label="{escape(name)}"', 1)
