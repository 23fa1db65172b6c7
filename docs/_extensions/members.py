"""What the reference leaves out of a class: what scikit-learn and ``NamedTuple`` put there."""


def skip(app, what, name, obj, would_skip, options):
    """Return whether to leave out a member, None to leave it to autodoc."""
    home = getattr(getattr(obj, "fget", obj), "__module__", None) or ""
    return True if home.startswith("sklearn.") or type(obj).__name__ == "_tuplegetter" else None


def setup(app):
    """Tell Sphinx."""
    app.connect("autodoc-skip-member", skip)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
