"""Reports: pictures and pages that a person looks at. The only code that knows matplotlib."""
