// A service that the board provides.
#pragma once

#include "publisher.h"
#include "subscriber.h"

namespace ros {

template <class Request, class Response, class T = void, size_t kArrayBytes = kStorageBytes>
class ServiceServer : public Receiver {
 public:
  // A function, or a lambda that captures at most three references.
  template <class F>
  ServiceServer(const char* service, F callback) : ServiceServer(service, Callback(callback)) {}
  ServiceServer(const char* service, void (*callback)(const Request&, Response&))
      : ServiceServer(service, Callback(callback)) {}
  template <class C, class Object>
  ServiceServer(const char* service, void (C::*member)(const Request&, Response&), Object* object)
      : ServiceServer(service, Callback(MemberOf<C, void (C::*)(const Request&, Response&)>{member, object})) {}
  template <class C, class Object>
  ServiceServer(const char* service, void (C::*member)(const Request&, Response&) const, Object* object)
      : ServiceServer(service,
                      Callback(MemberOf<const C, void (C::*)(const Request&, Response&) const>{member, object})) {}
  // The same with `Request&`, ROS's own spelling.
  ServiceServer(const char* service, void (*callback)(Request&, Response&))
      : ServiceServer(service, Callback(callback)) {}
  template <class C, class Object>
  ServiceServer(const char* service, void (C::*member)(Request&, Response&), Object* object)
      : ServiceServer(service, Callback(MemberOf<C, void (C::*)(Request&, Response&)>{member, object})) {}
  template <class C, class Object>
  ServiceServer(const char* service, void (C::*member)(Request&, Response&) const, Object* object)
      : ServiceServer(service, Callback(MemberOf<const C, void (C::*)(Request&, Response&) const>{member, object})) {}

  Sender& response() { return response_; }  // the other half of the service

 private:
  typedef Callable<void(Request&, Response&)> Callback;

  ServiceServer(const char* service, const Callback& callback)
      : Receiver(Kind::kServerRequest, service, Request::getType(), Request::getMD5(), Request::getSize(),
                 &ServiceServer::receive),
        response_(service),
        callback_(callback) {}

  struct Answer : public Sender {
    explicit Answer(const char* service)
        : Sender(Kind::kServerResponse, service, Response::getType(), Response::getMD5()) {}
  };

  static bool receive(Receiver& self, uint8_t* payload, size_t size) {
    ServiceServer& server = static_cast<ServiceServer&>(self);
    Storage<Request::getSize().is_fixed() ? 0 : kArrayBytes> storage;
    Reader in(payload, size, storage.start(), Request::getSize().is_fixed() ? 0 : kArrayBytes);
    Request request;
    if (!request.deserialize(in) || in.left() > 0) return false;
    Response response;
    server.callback_(request, response);
    server.node()->publish(server.response_, &response, &serialize_message<Response>);
    return true;
  }

  Answer response_;
  Callback callback_;
};

}  // namespace ros
