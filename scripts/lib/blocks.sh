# shellcheck shell=bash
# Sourced: commands() prints the commands of pages of the documentation, in order: each ```sh block that follows a line `<!-- run -->`.

commands() {
    awk '
        /^<!-- run -->$/       { marked = 1; next }
        marked && /^```sh$/    { on = 1; marked = 0; next }
        on && /^```$/          { on = 0; next }
        on                     { print; next }
        NF                     { marked = 0 }
    ' "$@"
}
