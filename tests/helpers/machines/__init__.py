"""Several machines: namespaces, a virtual machine, clocks."""
