"""What a device of your own has to pass: `scuhand_bt.testing.conformance`."""
