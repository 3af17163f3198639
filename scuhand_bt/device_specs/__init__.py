"""The models of the sections of `robot/cell.yaml` about the devices that every cell has."""
