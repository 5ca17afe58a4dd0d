"""`turtlelog --install-completion`: the completion script of the user's shell."""

from cyclopts.completion.install import create_install_completion_command

from turtlelog.cli.app import app

# As `app.register_install_completion_command` does, which loads all of this at every start.
install_completion = create_install_completion_command(app.install_completion, add_to_startup=False)
