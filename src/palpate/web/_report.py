"""An episode as one page that stands by itself."""

import base64
import time
from html import escape

from ._episode import LiveEpisode, LiveTouch
from ._pictures import thumbnail

_SHOWN = 5
_STYLE = """
:root{color-scheme:light dark;--line:#d5dbe1;--soft:#5a6572;--bar:#2f6f8f}
@media(prefers-color-scheme:dark){:root{--line:#39424c;--soft:#a3afbb;--bar:#6fb7d6}}
body{font:16px/1.5 system-ui,sans-serif;max-width:56rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem}h1,p,th{overflow-wrap:anywhere}.note{color:var(--soft)}
ol{list-style:none;padding:0}
li{display:grid;grid-template-columns:104px minmax(0,1fr);gap:1rem;align-items:center;
border-top:1px solid var(--line);padding:.8rem 0}
img{width:96px;border-radius:6px}
table{border-collapse:collapse;width:100%;table-layout:fixed}
th,td{text-align:left;padding:.1rem .5rem 0 0;
font-weight:400}td:last-child{text-align:right;width:4rem}
.track{background:var(--line);border-radius:4px;height:.6rem}
.bar{background:var(--bar);border-radius:4px;height:.6rem}
"""


def episode_report(episode: LiveEpisode) -> str:
    """Return one HTML page: the decision, and every touch with the belief after it.

    Nothing is loaded from elsewhere when it is looked at.

    Raises
    ------
    ValueError
        The episode has no touch yet.
    """
    if not episode.touches:
        raise ValueError("The episode has no touch yet; touch something first.")
    when = time.strftime("%Y-%m-%d %H:%M", time.localtime(episode.touches[0].time_s))
    decided = episode.decision or "undecided"
    items = "".join(_item(touch) for touch in episode.touches)
    return (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width,initial-scale=1'>"
        f"<title>Episode {episode.number}: {escape(decided)}</title>"
        f"<style>{_STYLE}</style><body>"
        f"<h1>Episode {episode.number}: {escape(decided)}</h1>"
        f"<p>{escape(episode.reason)}</p>"
        f"<p class=note>{when}, {len(episode.touches)} touches. At most "
        f"{episode.error:.1%} of decisions should be wrong.</p>"
        f"<ol>{items}</ol></body></html>"
    )


def _item(touch: LiveTouch) -> str:
    picture = base64.b64encode(thumbnail(touch.image)).decode()
    shown = sorted(touch.posterior.items(), key=lambda item: -item[1])[:_SHOWN]
    rows = "".join(_row(name, share) for name, share in shown)
    strangeness = ""
    if touch.unknown is not None and touch.limit is not None:
        strangeness = (
            f"<p class=note>Strangeness {touch.unknown:.3f}; unknown above "
            f"{touch.limit:.3f}.</p>"
        )
    return (
        f"<li><img alt='touch {touch.number}' src='data:image/png;base64,{picture}'>"
        f"<div><b>Touch {touch.number}</b><table>{rows}</table>{strangeness}</div></li>"
    )


def _row(name: str, share: float) -> str:
    width = f"{100 * share:.1f}%"
    return (
        f"<tr><th scope=row>{escape(name)}<div class=track>"
        f"<div class=bar style='width:{width}'></div></div></th>"
        f"<td>{width}</td></tr>"
    )
