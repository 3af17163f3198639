"""A plotly figure as a self-contained page: plotly's script inside, nothing from the network, light or dark as the
reader's computer is.

plotly is an optional extra (`pip install scuhand-bt[plot]`).
"""

import json
from html import escape
from typing import Any

from plotly import graph_objects as go
from plotly import io

_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px system-ui, sans-serif; margin: 20px auto; padding: 0 16px; max-width: 1200px; }
h1 { font-size: 24px; }
.figure { overflow-x: auto; }
.plotly-graph-div { min-width: 860px; }
td, th { padding: 2px 18px 2px 0; text-align: left; }
"""
_FOLLOW_THE_READER = """
const dark = matchMedia("(prefers-color-scheme: dark)"), figure = document.getElementById("{plot_id}");
const follow = () => Plotly.relayout(figure, {template: dark.matches ? DARK : LIGHT});
dark.addEventListener("change", follow);
follow();
"""


def figure_page(title: str, figure: go.Figure, intro: str = "", below: str = "") -> str:
    """The page; `intro` and `below` are HTML before and after the figure."""
    script = _FOLLOW_THE_READER
    for word, template in (("LIGHT", "plotly_white"), ("DARK", "plotly_dark")):
        script = script.replace(word, _json(io.templates[template].to_plotly_json()))
    transparent = "rgba(0,0,0,0)"
    figure.update_layout(paper_bgcolor=transparent, plot_bgcolor=transparent, font_family="system-ui, sans-serif")
    config = {"displaylogo": False, "responsive": True}
    drawn = figure.to_html(
        full_html=False, include_plotlyjs=True, include_mathjax=False, config=config, post_script=script
    )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width"><title>{escape(title)}</title><style>{_STYLE}</style>'
        f'</head><body><h1>{escape(title)}</h1>{intro}<div class="figure">{drawn}</div>{below}</body></html>\n'
    )


def _json(value: Any) -> str:
    # "</" would end the script, whatever it stands in.
    return json.dumps(value).replace("</", "<\\/")
