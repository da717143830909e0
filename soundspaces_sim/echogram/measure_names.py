"""Names of the room measures (ISO 3382-1), in the order of their columns in tables and standard errors."""

MEASURES = ("t20", "t30", "edt", "c50", "c80", "d50", "ts", "drr")
