"""The report: one page, complete in itself."""
