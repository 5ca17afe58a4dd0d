"""What a picture shows: its curves, levels, marks, colours and words. No room draws here."""
