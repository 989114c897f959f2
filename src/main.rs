//! The `physgrad` program; see `physgrad --help`.

// `println!` panics on a closed pipe. `terminal::say` and `terminal::tell` do not.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod program;

fn main() -> std::process::ExitCode {
    program::main()
}
