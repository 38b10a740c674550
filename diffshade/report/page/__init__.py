"""The report page: a fit on one HTML page, from its tables, charts, pictures, residuals and live ball."""
