"""HTML pages, self-contained: the report of a fit, and the inspection of recordings before one."""
