"""Normal-contact laws: one published law per file, and the registry that names them."""
