//! `egotac limits`.

use std::process::ExitCode;

use crate::file::limits;

/// Text above the table.
const HEAD: &str = "# Limits on input from outside

Printed by `egotac limits`.

Files, messages and options from outside are read within these limits. A number from a header is also compared with the bytes
that are there, before any memory is allocated. An input above a limit is refused, with the name of the file or topic and of
the variable; set the variable to accept it, for instance `EGOTAC_LIMIT_IMAGE_PIXELS=100000000 egotac label ...`.

Inputs are regular files: pipes, sockets and devices are refused. Symbolic links inside a data set lead to files of the same
data set; `--follow-links` permits others. In a snapshot of the Hugging Face cache, links to its blobs are permitted.

While a bag is labelled, one record or chunk of it, its decompressed form and one of its images are in memory, beside at most
512 MiB of images that wait for the network; while it is copied, two chunks. A cell of a Parquet file is in memory up to five times
while its row is copied, compressed and decompressed; a page of several cells that hardly shrink may exceed the limit of pages.

";

/// Runs the command.
pub fn run() -> anyhow::Result<ExitCode> {
    print!("{HEAD}{}", limits::table());
    Ok(ExitCode::SUCCESS)
}
