"""Why a metric differs between two runs."""
