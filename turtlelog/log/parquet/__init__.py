"""Reading of Parquet files: checked before Arrow allocates memory."""
