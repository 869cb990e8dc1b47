"""The fish with one tail fin of chapter 5, held by a bar in a small tank."""
