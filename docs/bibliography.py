"""Write ``paper/paper.bib``: publications that the paper cites, as `glucoloop cite` prints them, and other programs.

python docs/bibliography.py
"""

import re
from pathlib import Path

from glucoloop.component.listing import known_references, reference

PAPER = Path(__file__).resolve().parent.parent / "paper/paper.md"
PROGRAMS = {
    "glucoenv": ("GluCoEnv authors", "GluCoEnv", "https://github.com/RL4H/GluCoEnv"),
    "jax": (
        "JAX authors",
        "JAX: composable transformations of Python and NumPy programs",
        "https://github.com/jax-ml/jax",
    ),
    "loopinsight": ("LoopInsighT1 authors", "LoopInsighT1", "https://github.com/hpeuscher/loopinsight1"),
    "mgipsim": ("py-mgipsim authors", "py-mgipsim", "https://github.com/illinoistech-itm/py-mgipsim"),
    "replaybg": ("py\\_replay\\_bg authors", "py\\_replay\\_bg", "https://github.com/gcappon/py_replay_bg"),
    "simglucose": ("simglucose authors", "simglucose, version 0.2.11", "https://github.com/jxx123/simglucose"),
    "tidepool": (
        "Tidepool authors",
        "Tidepool data science simulator",
        "https://github.com/tidepool-org/data-science-simulator",
    ),
}
"""Programs that have no publication here: author, title and place."""


def cited(text: str) -> list[str]:
    """Keys that a text in Markdown cites, each once and in order."""
    return sorted(set(re.findall(r"(?<![\w.])@([a-z]+\d*[a-z]*\d*)", text)))


def bibliography(text: str) -> str:
    """Entries of all keys that a text cites."""
    entries = []
    for key in cited(text):
        if key in known_references():
            entries.append(reference(key).bibtex())
        else:
            author, title, url = PROGRAMS[key]
            fields = {"author": f"{{{author}}}", "title": f"{{{title}}}", "url": url}
            lines = ",\n".join(f"  {name} = {{{value}}}" for name, value in fields.items())
            entries.append(f"@misc{{{key},\n{lines}\n}}")
    return "\n\n".join(entries) + "\n"


if __name__ == "__main__":
    PAPER.with_name("paper.bib").write_text(bibliography(PAPER.read_text(encoding="utf-8")), encoding="utf-8")
