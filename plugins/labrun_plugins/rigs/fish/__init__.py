"""The fish with two pectoral five-bars and a tail of chapter 6, on an arm that can tow it."""
