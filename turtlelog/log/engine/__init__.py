"""Reading of files as columns: thousands of messages at once instead of one by one."""
