"""The independent judge of a scoop: discrete elements, by Debian's `yade`, in a process of its own."""
