"""`turtlelog --install-completion`: the completion script for the user's shell."""

from cyclopts.completion.install import create_install_completion_command

from turtlelog.cli.app import app

# Like `app.register_install_completion_command`, which loads all this at every start.
install_completion = create_install_completion_command(app.install_completion, add_to_startup=False)
