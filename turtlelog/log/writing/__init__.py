"""Writing of messages: encoded, in chunks, into containers and other formats."""
