"""Display: units, colours, pictures, tables and pages, of plots, reports and flight cards alike."""
