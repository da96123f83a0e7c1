"""Making records from results, scoring them again, checking them, and what is published of hidden splits."""
