//! The `physgrad` program; see `physgrad --help`.

fn main() -> std::process::ExitCode {
    physgrad_cli::program().main()
}
