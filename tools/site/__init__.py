"""The documentation site: ``python -m tools.site`` (``make docs``).

``source`` gathers plain Markdown into one folder, with ``api`` and ``examples`` writing the pages that nobody writes by
hand; zensical turns it into HTML; ``links`` follows every link of the result. docs/decisions/0031-site.md says why.
"""
