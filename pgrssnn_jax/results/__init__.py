"""What the API gives back: trained members and discoveries, saved to run folders, loaded from them and verified."""
