"""One table with the metrics of many recordings."""
