//! The `physgrad` program; see `physgrad --help`.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
