from .urls import (
    RemoteNote as RemoteNote,
    RemotePath as RemotePath,
    hide_secrets as hide_secrets,
    is_url as is_url,
    limit_downloads as limit_downloads,
    make_path as make_path,
    show_url as show_url,
)
