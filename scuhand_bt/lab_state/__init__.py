"""What a lab remembers from run to run: what is believed of its powders and balance, and its inventory."""
