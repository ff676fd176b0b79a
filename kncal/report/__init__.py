"""From numbers and records to a page of tables and figures; knows no engine."""
