"""Pages of a data set for people: Open-H's README and the card of the Hugging Face Hub."""
