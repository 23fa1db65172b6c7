"""What the reference leaves out of a class: what scikit-learn and ``NamedTuple`` put there."""

import re

REQUEST = re.compile(r"set_\w+_request")  # of scikit-learn's metadata routing


def skip(app, what, name, obj, would_skip, options):
    """Return whether to leave out a member, None to leave it to autodoc."""
    return True if REQUEST.fullmatch(name) or type(obj).__name__ == "_tuplegetter" else None


def setup(app):
    """Tell Sphinx."""
    app.connect("autodoc-skip-member", skip)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
