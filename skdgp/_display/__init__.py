"""What is shown: units, colours, pictures, tables and pages, of plots, reports and flight cards alike."""
