//! Wire form of the messages and their CDR bytes.
