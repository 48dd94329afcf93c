"""What a run says to people: tables for the terminal, figures, and one self-contained HTML page."""
