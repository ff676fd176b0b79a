"""Text of a solver, made safe to keep and to show."""

from __future__ import annotations

#: Longer lines are cut [bytes]; solvers write shorter ones, but a damaged file may be one endless line.
MAX_LINE = 4096


def decode_line(line: bytes) -> str:
    """Decode one line of a log: at most `MAX_LINE` bytes, without blanks at the end.

    LIGGGHTS may write random bytes after an error; those, and control characters that a terminal would obey,
    become U+FFFD.
    """
    text = line[:MAX_LINE].decode("utf-8", errors="replace").rstrip()
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\t" else "\ufffd" for c in text)
