"""Class of which every reader of files is one."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from glucoloop.component.base import Component

if TYPE_CHECKING:
    from glucoloop.records.answers import Answers
    from glucoloop.records.extract import Extract
    from glucoloop.records.file_text import FileText


class ReaderComponent(Component):
    """Reader of files of one kind: a class in a file of its own, entered in `readers.READERS`.

    A package of your own enters it by an entry point in the group ``glucoloop.readers``.
    """

    kind: ClassVar = "reader"
    in_parts: ClassVar[bool] = False
    """Whether what it reads of a person comes as several files, of which one alone has the readings."""
    in_exports: ClassVar[bool] = False
    """Whether all files of a folder are the export of one person, however many have readings."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file is one of its kind."""
        raise NotImplementedError

    def with_profiles(self, content: FileText, answers: Answers) -> Answers | None:
        """Answers with what a file holds about the others of a person; None for a file with rows of its own."""
        return None

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of a file, every one of them; Refusal where it leaves something open that was not given."""
        raise NotImplementedError
