//! The `physgrad` program; see `physgrad --help`.

// `println!` panics if nobody reads: `terminal::say` and `terminal::tell` do not.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
