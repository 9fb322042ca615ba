"""OPC UA: the address space, and the server with who may come in."""
