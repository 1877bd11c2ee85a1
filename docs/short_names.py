"""Sphinx extension: resolve a short name, like `simulate`, to the one object of the package that ends in it."""

from collections import defaultdict
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment


class ShortNames:
    """Full names by their last part, collected once all pages are read."""

    def __init__(self) -> None:
        self.of_last: defaultdict[str, list[str]] | None = None

    def known(self, objects: dict[str, Any], target: str) -> list[str]:
        if self.of_last is None:
            self.of_last = defaultdict(list)
            for name in objects:
                self.of_last[name.rpartition(".")[2]].append(name)
        return [name for name in self.of_last[target.rpartition(".")[2]] if name.endswith(f".{target}")]

    def resolve(
        self, app: Sphinx, env: BuildEnvironment, node: addnodes.pending_xref, contnode: nodes.Element
    ) -> nodes.Element | None:
        if node.get("refdomain") != "py" or not node.get("reftarget"):
            return None
        domain = env.get_domain("py")
        objects: dict[str, Any] = domain.objects  # type: ignore[attr-defined]
        result = self.known(objects, node["reftarget"])
        if len(result) != 1:
            return None
        entry = objects[result[0]]
        return nodes.reference(
            "",
            "",
            contnode,
            internal=True,
            refuri=app.builder.get_relative_uri(node["refdoc"], entry.docname) + "#" + entry.node_id,
            reftitle=result[0],
        )


def leave_words(app: Sphinx, doctree: nodes.document) -> None:
    """In "array_like, shape (points, ...)" no word is the name of a class."""
    for node in list(doctree.findall(addnodes.pending_xref)):
        target = node.get("reftarget", "")
        word = target[:1].islower() and "." not in target
        if node.get("refdomain") == "py" and node.get("reftype") == "class" and word:
            node.replace_self(node.children)


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("doctree-read", leave_words)
    app.connect("missing-reference", ShortNames().resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
