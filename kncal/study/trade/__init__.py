"""Speed for accuracy: how soft, and how coarse in time, a contact may be for what it saves."""
